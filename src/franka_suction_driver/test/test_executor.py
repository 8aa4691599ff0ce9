"""The executor against an arm that follows exactly, in worlds given as force fields."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from flowbothd_common.errors import MotionRejectedError
from flowbothd_common.motion import MotionGoal, MotionKind, MotionReason
from flowbothd_common.transforms import angle_between, rotation_about
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.arm.trajectory import state_at
from franka_suction_driver.execution.executor import MotionExecutor
from franka_suction_driver.params import MotionParams
from franka_suction_driver.planning.inverse_kinematics import solve

START = np.array(MotionParams().robot.start_positions)
FORWARD = np.array([1.0, 0, 0])
STIFFNESS = 3000.0


@pytest.fixture
def executor(robot: Kinematics, motion_params: MotionParams) -> MotionExecutor:
    return MotionExecutor(robot, motion_params, seed=1)


@pytest.fixture
def facing(robot: Kinematics, limits: JointLimits) -> np.ndarray:
    """A roomy configuration with the tool pointing forward at (0.55, -0.1, 0.5)."""
    box = limits.box(0.1)
    seeds = box.sample(np.random.default_rng(0), 256)
    found = solve(robot, box, seeds, np.array([0.55, -0.1, 0.5]), FORWARD)
    return found[int(np.argmax(box.margin(found)))]


def wall_at(x: float):
    """A stiff plane that pushes back."""
    return lambda tip: -FORWARD * STIFFNESS * max(0.0, tip[0] - x)


def step(direction: np.ndarray, distance: float = 0.0) -> MotionGoal:
    return MotionGoal(MotionKind.FLOW_STEP, None, direction, distance)


def probe(direction: np.ndarray = FORWARD) -> MotionGoal:
    return MotionGoal(MotionKind.PROBE, None, direction)


def assert_continuous_and_limited(arm, limits: JointLimits) -> None:
    """Every trajectory is within limits, ends at rest, and was entered without a jump."""
    assert arm.issued
    for k, (time, entered, trajectory) in enumerate(arm.issued):
        assert limits.violation(trajectory) is None
        assert not trajectory.velocities[-1].any()
        assert not trajectory.accelerations[-1].any()
        if k == 0:
            continue
        before_time, before_entered, before = arm.issued[k - 1]
        running = state_at(before, before_entered, time - before_time)
        np.testing.assert_allclose(entered.velocity, running.velocity, atol=1e-9)
        # The first point agrees with going on from the running state at bounded acceleration.
        first = float(trajectory.times[0])
        predicted = running.position + running.velocity * first
        allowed = limits.acceleration * first**2 + 1e-4
        assert (np.abs(trajectory.positions[0] - predicted) <= allowed).all()


def assert_replaced_seldom(arm) -> None:
    times = np.array([time for time, _, _ in arm.issued])
    assert (np.diff(times) > 0.049).mean() > 0.9


def test_a_free_flow_step_is_straight_and_as_long_as_asked(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray, limits: JointLimits
) -> None:
    arm = make_arm(facing)
    arm.vacuum = lambda tip: True
    result = arm.run(executor, step(-FORWARD))
    assert result.reason is MotionReason.REACHED
    assert result.reached_fraction == pytest.approx(1.0)
    np.testing.assert_allclose(result.tool_motion, [-0.05, 0, 0], atol=5e-4)
    tips = np.array(arm.tips)
    assert np.abs(tips[:, 1:] - tips[0, 1:]).max() < 5e-4
    assert result.max_lag < 0.01
    assert arm.fractions == sorted(arm.fractions)
    assert_continuous_and_limited(arm, limits)


def test_the_tool_turns_to_the_flow_within_the_step(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray, robot: Kinematics
) -> None:
    arm = make_arm(facing)
    arm.vacuum = lambda tip: True
    flow = rotation_about((0, 0, 1), 0.3) @ -FORWARD
    result = arm.run(executor, step(flow))
    assert result.reason is MotionReason.REACHED
    axis = robot.tip(arm.state.position).axis
    # Half of the turn ahead of the flow: the part goes on turning.
    assert angle_between(axis, FORWARD) == pytest.approx(0.45, abs=0.01)


def test_a_step_follows_an_arc_by_giving_way(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray, limits: JointLimits
) -> None:
    """A stiff cup on a hinged leaf: five centimetres along the tangent leave the arc by 9 mm."""
    arm = make_arm(facing)
    hinge = arm.tip + np.array([0, 0.148, 0])

    def leaf(tip: np.ndarray) -> np.ndarray:
        arm_vector = (tip - hinge) * [1, 1, 0]
        distance = np.linalg.norm(arm_vector)
        return STIFFNESS * (0.148 - distance) * arm_vector / distance

    arm.force = leaf
    arm.vacuum = lambda tip: True
    result = arm.run(executor, step(-FORWARD))
    assert result.reason is MotionReason.REACHED, result.message
    radius = np.linalg.norm((arm.tip - hinge)[:2])
    assert radius == pytest.approx(0.148, abs=0.002)
    assert np.linalg.norm(result.peak_wrench[:3]) < 12.0
    assert_continuous_and_limited(arm, limits)
    assert_replaced_seldom(arm)


def test_a_blocked_part_ends_the_step_promptly_and_is_let_go(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray, limits: JointLimits
) -> None:
    arm = make_arm(facing)
    origin = arm.tip.copy()
    arm.force = lambda tip: STIFFNESS * (origin - tip)
    arm.vacuum = lambda tip: True
    result = arm.run(executor, step(-FORWARD))
    assert result.reason is MotionReason.FORCE_LIMIT
    assert "limit 22 N" in result.message
    assert result.reached_fraction < 0.3
    assert np.linalg.norm(result.peak_wrench[:3]) < 32.0
    assert np.linalg.norm(arm.force(arm.tip)) < 6.0
    assert result.duration < 2.0
    assert_continuous_and_limited(arm, limits)


def test_letting_go_never_swings_out(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray
) -> None:
    """The incident: a slowed replacement of the running offset swung the tool back by 20 cm."""
    arm = make_arm(facing)
    origin = arm.tip.copy()
    rng = np.random.default_rng(0)

    def rattling(tip: np.ndarray) -> np.ndarray:
        return STIFFNESS * (origin - tip) * [1, 0, 0] + rng.normal(size=3) * 15

    arm.force = rattling
    arm.vacuum = lambda tip: True
    result = arm.run(executor, step(-FORWARD))
    assert result.reason is MotionReason.FORCE_LIMIT
    tips = np.array(arm.tips)
    assert (tips[:, 0] - origin[0]).max() < 0.015
    assert np.abs(tips[:, 1:] - origin[1:]).max() < 0.045


def test_a_lost_part_ends_the_step(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray
) -> None:
    arm = make_arm(facing)
    origin = arm.tip.copy()
    arm.vacuum = lambda tip: origin[0] - tip[0] < 0.02
    result = arm.run(executor, step(-FORWARD))
    assert result.reason is MotionReason.SUCTION_LOST
    assert 0.3 < result.reached_fraction < 0.6
    assert not result.vacuum


@pytest.mark.parametrize(
    ("force", "reason"), [(0.0, MotionReason.LAGGING), (12.0, MotionReason.STALLED)]
)
def test_a_tool_that_stays_behind_is_stalled_if_something_holds_it(
    executor: MotionExecutor,
    make_arm: Callable,
    facing: np.ndarray,
    force: float,
    reason: MotionReason,
) -> None:
    """An arm that nothing holds was held by its controller, which says nothing of the part."""
    arm = make_arm(facing)
    arm.vacuum = lambda tip: True
    arm.force = lambda tip: force * FORWARD
    arm.follows = False
    result = arm.run(executor, step(-FORWARD))
    assert result.reason is reason
    assert "behind" in result.message
    approach = arm.run(executor, MotionGoal(MotionKind.RETREAT))
    assert approach.reason in (MotionReason.REJECTED, MotionReason.LAGGING)


def test_steps_without_a_part_or_without_a_wrench_do_not_begin(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray
) -> None:
    arm = make_arm(facing)
    assert arm.run(executor, step(-FORWARD)).reason is MotionReason.SUCTION_LOST
    arm.wrench_known = False
    blind = arm.run(executor, probe())
    assert blind.reason is MotionReason.STALE_INPUT
    assert "wrench" in blind.message
    assert not arm.issued


def test_a_probe_stops_inside_an_increment_on_vacuum(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray, limits: JointLimits
) -> None:
    arm = make_arm(facing)
    surface = arm.tip[0] + 0.093
    arm.force = wall_at(surface)
    arm.vacuum = lambda tip: tip[0] > surface + 0.001
    result = arm.run(executor, probe())
    assert result.reason is MotionReason.VACUUM
    assert result.vacuum
    assert result.contact
    assert abs(arm.tip[0] - surface) < 0.004
    assert np.linalg.norm(result.peak_wrench[:3]) < 12.0
    assert_continuous_and_limited(arm, limits)


def test_contact_without_vacuum_waits_and_says_so(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray
) -> None:
    arm = make_arm(facing)
    arm.force = wall_at(arm.tip[0] + 0.07)
    result = arm.run(executor, probe())
    assert result.reason is MotionReason.CONTACT
    assert "no vacuum within 0.8 s" in result.message
    assert np.linalg.norm(result.peak_wrench[:3]) < 20.0


def test_a_probe_into_nothing_ends_after_twelve_centimetres(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray
) -> None:
    arm = make_arm(facing)
    result = arm.run(executor, probe(-FORWARD))
    assert result.reason is MotionReason.NO_CONTACT
    assert "12 cm" in result.message
    # Asked against the tool, it still travels where the tool points.
    np.testing.assert_allclose(result.tool_motion, [0.12, 0, 0], atol=1e-3)


def test_stop_brakes_within_the_limits(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray, limits: JointLimits
) -> None:
    assert executor.stop() is False
    arm = make_arm(facing)
    arm.vacuum = lambda tip: True
    executor.start(step(-FORWARD), arm.observe())
    for _ in range(40):
        update = executor.tick(arm.observe())
        if update.trajectory is not None:
            arm.take(update.trajectory)
        arm.advance()
    assert executor.stop(MotionReason.STALE_INPUT, "joint_states silent")
    result = arm.finish(executor)
    assert result.reason is MotionReason.STALE_INPUT
    assert result.message == "joint_states silent"
    assert not arm.state.velocity.any()
    assert 0.1 < result.reached_fraction < 0.9
    assert_continuous_and_limited(arm, limits)


def test_one_motion_at_a_time(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray
) -> None:
    arm = make_arm(facing)
    executor.start(probe(), arm.observe())
    with pytest.raises(MotionRejectedError, match="another motion is running"):
        executor.start(probe(), arm.observe())
    arm.finish(executor)
    executor.start(probe(), arm.observe())


def test_a_moving_arm_is_not_started(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray
) -> None:
    arm = make_arm(facing)
    arm.state = type(arm.state)(facing, np.full(7, 0.2), np.zeros(7))
    result = arm.run(executor, probe())
    assert result.reason is MotionReason.REJECTED
    assert "still moves (0.20 rad/s)" in result.message


def test_an_arm_that_trembles_where_it_was_told_to_rest_may_go_on(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray
) -> None:
    """The incident: a part that came off let the joints tremble; the next step was refused."""
    arm = make_arm(facing)
    arm.vacuum = lambda tip: True
    assert arm.run(executor, step(-FORWARD)).reason is MotionReason.REACHED
    arm.state = type(arm.state)(arm.state.position, np.full(7, 0.3), np.zeros(7))
    assert arm.run(executor, step(-FORWARD)).reason is MotionReason.REACHED


def test_approach_probe_step_retreat_in_a_row(
    executor: MotionExecutor, make_arm: Callable, limits: JointLimits
) -> None:
    arm = make_arm(START)
    contact = np.array([0.55, 0.1, 0.3])
    arm.force = lambda tip: wall_at(contact[0])(tip) if not arm.vacuum(tip) else np.zeros(3)
    there = MotionGoal(MotionKind.APPROACH, contact, -FORWARD)
    reached = arm.run(executor, there)
    assert reached.reason is MotionReason.REACHED, reached.message
    np.testing.assert_allclose(arm.tip, contact - 0.1 * FORWARD, atol=1e-3)
    held = [False]
    arm.vacuum = lambda tip: held[0] or tip[0] > contact[0] + 0.001
    assert arm.run(executor, probe()).reason is MotionReason.VACUUM
    held[0] = True
    assert arm.run(executor, step(-FORWARD)).reason is MotionReason.REACHED
    stuck = arm.run(executor, MotionGoal(MotionKind.RETREAT))
    assert stuck.reason is MotionReason.REJECTED
    assert "suction off" in stuck.message
    arm.vacuum = lambda tip: False
    home = arm.run(executor, MotionGoal(MotionKind.RETREAT))
    assert home.reason is MotionReason.REACHED
    np.testing.assert_allclose(arm.state.position, START, atol=1e-6)
    assert_continuous_and_limited(arm, limits)


def test_an_unexpected_contact_stops_a_free_motion(
    executor: MotionExecutor, make_arm: Callable
) -> None:
    arm = make_arm(START)
    origin = arm.tip.copy()
    arm.force = lambda tip: STIFFNESS * (origin - tip) * (np.linalg.norm(tip - origin) > 0.05)
    result = arm.run(
        executor, MotionGoal(MotionKind.APPROACH, np.array([0.55, 0.1, 0.3]), -FORWARD)
    )
    assert result.reason is MotionReason.FORCE_LIMIT
    assert "unexpected contact" in result.message
    assert not arm.state.velocity.any()


def test_equal_seeds_move_equally(
    robot: Kinematics, make_arm: Callable, motion_params: MotionParams
) -> None:
    goal = MotionGoal(MotionKind.APPROACH, np.array([0.5, -0.2, 0.3]), np.array([0, 1.0, 0]))
    ends = []
    for _ in range(2):
        arm = make_arm(START)
        arm.run(MotionExecutor(robot, motion_params, seed=4), goal)
        ends.append(np.concatenate([t.positions for _, _, t in arm.issued]))
    np.testing.assert_array_equal(ends[0], ends[1])


def test_a_step_beyond_reach_goes_as_far_as_it_can(
    executor: MotionExecutor, make_arm: Callable, facing: np.ndarray, limits: JointLimits
) -> None:
    arm = make_arm(facing)
    arm.vacuum = lambda tip: True
    result = arm.run(executor, step(FORWARD, 0.5), limit=60.0)
    assert result.reason in (MotionReason.JOINT_LIMIT, MotionReason.SINGULARITY)
    assert 0.2 < result.reached_fraction < 0.99
    assert "reaches only" in result.message
    assert_continuous_and_limited(arm, limits)


def test_a_step_ends_before_the_arm_touches_the_table(
    executor: MotionExecutor, make_arm: Callable, limits: JointLimits
) -> None:
    """The incident: following a low drawer pressed the wrist onto the table with 600 N."""
    arm = make_arm(START)
    arm.vacuum = lambda tip: True
    down = np.array([0, 0, -1.0])
    result = arm.run(executor, step(down, 0.45))
    assert result.reason is MotionReason.COLLISION
    assert "table" in result.message
    assert 0.6 < result.reached_fraction < 1.0
    assert min(tip[2] for tip in arm.tips) > 0.0
    assert_continuous_and_limited(arm, limits)
