"""Tool paths: solved once, straight, timed within every limit, slower where the arm is awkward."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flowbothd_common.motion import JointState, JointTrajectory
from flowbothd_common.transforms import unit
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.arm.trajectory import SAMPLE, joint_move, joint_stop, state_at
from franka_suction_driver.arm.trajectory_check import (
    TrajectorySamples,
    fine_samples,
    fine_violation,
)
from franka_suction_driver.execution.cartesian_planner import CartesianPlanner, SlowZones
from franka_suction_driver.execution.local_ik import LocalIk
from franka_suction_driver.execution.tool_path import solve_path
from franka_suction_driver.execution.tool_reference import Bounds, Reference, ToolLine
from franka_suction_driver.planning.inverse_kinematics import follow, solve

FORWARD = np.array([1.0, 0, 0])


@pytest.fixture(scope="module")
def facing(robot: Kinematics, limits: JointLimits) -> np.ndarray:
    box = limits.box(0.1)
    seeds = box.sample(np.random.default_rng(0), 256)
    found = solve(robot, box, seeds, np.array([0.55, -0.1, 0.5]), FORWARD)
    return found[int(np.argmax(box.margin(found)))]


def line_from(robot: Kinematics, q: np.ndarray, direction: np.ndarray, length: float) -> ToolLine:
    tip = robot.tip(q)
    return ToolLine(tip.position, direction, length, tip.axis, tip.axis, 0.0)


def test_the_quick_solver_goes_where_the_batch_solver_goes(
    robot: Kinematics, limits: JointLimits, facing: np.ndarray
) -> None:
    box = limits.box(0.05)
    solver = LocalIk(robot, box, 0.2)
    tip = robot.tip(facing)
    goal = tip.position - 0.004 * FORWARD + np.array([0, 0.002, 0])
    quick = solver.reach(facing, goal, tip.axis)
    batch = follow(robot, box, facing[None], goal[None], tip.axis[None], iterations=8)
    assert quick is not None
    np.testing.assert_allclose(quick, batch.positions[0, 0], atol=1e-6)
    np.testing.assert_allclose(robot.tip(quick).position, goal, atol=1e-6)
    np.testing.assert_allclose(solver.tips(quick[None])[0], robot.tip(quick).position, atol=1e-12)


def test_a_pose_out_of_reach_is_none_and_never_leaves_the_box(
    robot: Kinematics, limits: JointLimits, facing: np.ndarray
) -> None:
    solver = LocalIk(robot, limits.box(0.05), 0.2)
    assert solver.reach(facing, np.array([2.0, 0, 0.5]), FORWARD) is None


def test_a_path_keeps_to_its_line_between_the_nodes_too(
    robot: Kinematics, limits: JointLimits, facing: np.ndarray
) -> None:
    solver = LocalIk(robot, limits.box(0.05), 0.2)
    planner = CartesianPlanner(robot, limits, limits.box(0.05), 0.2)
    line = line_from(robot, facing, -FORWARD, 0.12)
    path = solve_path(line, facing, solver)
    assert path.length == pytest.approx(0.12)
    _, timed = planner.plan(line, Bounds(0.08), JointState.at_rest(facing))
    assert timed.trajectory is not None
    start = JointState.at_rest(facing)
    times = np.arange(0.0, float(timed.trajectory.times[-1]), 0.004)
    tips = np.array(
        [robot.tip(state_at(timed.trajectory, start, t).position).position for t in times]
    )
    assert np.abs((tips - line.origin)[:, 1:]).max() < 5e-4


def test_a_path_cut_short_keeps_to_its_line_as_well(robot: Kinematics, limits: JointLimits) -> None:
    """A spline through the first nodes alone left the line by 1 mm where the joints bend."""
    box = limits.box(0.05)
    solver = LocalIk(robot, box, 0.2)
    rng = np.random.default_rng(3)
    cut, worst = 0, 0.0
    for _ in range(150):
        start = rng.uniform(box.lower, box.upper)
        direction = unit(rng.normal(size=3))
        path = solve_path(line_from(robot, start, direction, 0.05), start, solver)
        if not 0.004 < path.length < 0.049:
            continue
        cut += 1
        names = tuple(f"joint_{k}" for k in range(len(start)))
        line = line_from(robot, start, direction, 0.05)
        reference = Reference.start(line, Bounds(0.04), path.length)
        times = np.linspace(0.0, reference.along_end, 200)
        tips = solver.tips(path.timed(names, reference, times).positions) - line.origin
        off = tips - np.outer(tips @ direction, direction)
        worst = max(worst, float(np.linalg.norm(off, axis=1).max()))
    assert cut > 20
    assert worst < 5e-4


def test_a_path_that_cannot_be_followed_ends_with_the_joint_that_ends_it(
    robot: Kinematics, limits: JointLimits, facing: np.ndarray
) -> None:
    planner = CartesianPlanner(robot, limits, limits.box(0.05), 0.2)
    line = line_from(robot, facing, FORWARD, 0.5)
    _, timed = planner.plan(line, Bounds(0.04), JointState.at_rest(facing))
    assert timed.problem in ("joint_limit", "singularity")
    assert timed.detail
    assert 0.05 < timed.travel < 0.5


def test_the_tool_slows_down_near_a_singularity_and_near_joint_limits(
    robot: Kinematics, limits: JointLimits, facing: np.ndarray
) -> None:
    box = limits.box(0.05)
    line = line_from(robot, facing, -FORWARD, 0.05)
    start = JointState.at_rest(facing)

    def planned(zones: SlowZones) -> tuple[float, float]:
        _, timed = CartesianPlanner(robot, limits, box, 0.2, zones).plan(line, Bounds(0.04), start)
        assert timed.trajectory is not None
        return timed.slowing, float(timed.trajectory.times[-1])

    free = planned(SlowZones(0.0, 0.0))
    assert free[0] == 1.0
    room = float(box.margin(facing))
    near_limit = planned(SlowZones(0.0, 3.0 * room))
    assert near_limit[0] < 0.5
    assert near_limit[1] > 1.5 * free[1]
    near_singularity = planned(SlowZones(10.0, 0.0))
    assert near_singularity[0] == pytest.approx(0.1, abs=0.05)
    assert near_singularity[1] > near_limit[1]


def test_joint_motions_and_stops_hold_the_limits_between_their_points(
    robot: Kinematics, limits: JointLimits
) -> None:
    """The incident: quintics between the samples of a jerk-limited profile overshot by half."""
    rng = np.random.default_rng(5)
    box = limits.box(0.2)
    for _ in range(20):
        start, goal = box.sample(rng, 2)
        rest = JointState.at_rest(start)
        move = joint_move(robot.joint_names, rest, goal, limits)
        assert fine_violation(limits, move, rest) is None
        moment = float(rng.uniform(0.1, 0.9)) * float(move.times[-1])
        moving = state_at(move, rest, moment)
        stop = joint_stop(robot.joint_names, moving, limits)
        assert fine_violation(limits, stop, moving) is None


def test_stops_from_hard_manoeuvres_hold_the_limits_between_their_points(
    robot: Kinematics, limits: JointLimits
) -> None:
    """The incident: a step pushed sideways was stopped, and overshot an acceleration by 1 %."""
    rng = np.random.default_rng(0)
    middle, finer = (limits.upper + limits.lower) / 2, 0
    for _ in range(500):
        velocity = rng.uniform(-1, 1, 7) * limits.velocity * rng.uniform(0, 0.1)
        acceleration = rng.uniform(-0.98, 0.98, 7) * limits.acceleration
        moving = JointState(middle, velocity, acceleration)
        stop = joint_stop(robot.joint_names, moving, limits)
        finer += bool(stop.times[0] < 0.6 * SAMPLE and stop.times[-1] > SAMPLE)
        assert fine_violation(limits, stop, moving) is None
    assert finer > 0, "none was hard enough to need closer points"


def test_extremes_between_two_points_are_found_exactly(
    robot: Kinematics, limits: JointLimits
) -> None:
    """Five places of an interval miss more than a hundredth of the peak."""
    rng = np.random.default_rng(1)
    missed = 0.0

    def worst(samples: TrajectorySamples) -> float:
        parts = (
            (samples.velocities, limits.velocity),
            (samples.accelerations, limits.acceleration),
            (samples.jerks, limits.jerk),
        )
        return max(float((np.abs(values) / limit).max()) for values, limit in parts)

    wide = replace(limits, lower=limits.lower - 9, upper=limits.upper + 9)
    for _ in range(50):
        rest = JointState.at_rest(np.zeros(7))
        values = rng.normal(size=(3, 2, 7)) * [[[0.01]], [[0.3]], [[3.0]]]
        move = JointTrajectory(robot.joint_names, np.array([0.04, 0.09]), *values)
        found = fine_violation(wide, move, rest, tolerance=-0.999)
        truth = worst(fine_samples(move, rest, np.linspace(0, 1, 2001)))
        assert found is not None
        assert found.ratio == pytest.approx(truth, rel=1e-3)
        missed = max(missed, 1 - worst(fine_samples(move, rest)) / truth)
    assert missed > 0.01


def test_the_fine_check_sees_what_the_points_do_not_show(
    robot: Kinematics, limits: JointLimits, facing: np.ndarray
) -> None:
    rest = JointState.at_rest(facing)
    move = joint_move(robot.joint_names, rest, facing + 0.1, limits)
    fine = fine_samples(move, rest)
    assert len(fine.times) == 5 * len(move.times)
    np.testing.assert_allclose(fine.positions[4::5], move.positions, atol=1e-12)
    np.testing.assert_allclose(fine.accelerations[4::5], move.accelerations, atol=1e-6)
    assert limits.violation(move) is None
    jumped = fine_violation(limits, move, JointState.at_rest(facing - 0.03))
    assert jumped is not None
    assert jumped.time <= move.times[0]
    bent = replace(move, velocities=move.velocities * 0.2)
    assert fine_violation(limits, bent, rest) is not None
