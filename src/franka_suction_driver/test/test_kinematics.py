"""Kinematics by algebraic truth: derivatives, round trips, limits."""

from __future__ import annotations

import numpy as np
import pytest

from flowbothd_common.errors import ParameterError
from flowbothd_common.transforms import angle_between, rotation_about, unit
from franka_suction_driver.arm.kinematics import (
    Kinematics,
    conditioning,
    damped_inverse,
    task_error,
    task_jacobian,
)
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.planning.inverse_kinematics import follow, limited_step, solve


def some(limits: JointLimits, count: int, seed: int = 0) -> np.ndarray:
    return limits.box(0.2).sample(np.random.default_rng(seed), count)


def test_jacobian_is_the_derivative_of_the_pose(robot: Kinematics, limits: JointLimits) -> None:
    h = 1e-6
    for q in some(limits, 20):
        jacobian = robot.tip(q).jacobian
        for j in range(7):
            step = np.eye(7)[j] * h
            before, after = robot.tip(q - step), robot.tip(q + step)
            linear = (after.position - before.position) / (2 * h)
            turn = (after.rotation @ before.rotation.T - np.eye(3)) / (2 * h)
            angular = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
            np.testing.assert_allclose(jacobian[:3, j], linear, atol=1e-7)
            np.testing.assert_allclose(jacobian[3:, j], angular, atol=1e-5)


def test_many_at_once_equals_one_by_one(robot: Kinematics, limits: JointLimits) -> None:
    configurations = some(limits, 30)
    batch = robot.tip(configurations)
    for k, q in enumerate(configurations):
        single = robot.tip(q)
        np.testing.assert_allclose(batch.position[k], single.position, atol=1e-12)
        np.testing.assert_allclose(batch.rotation[k], single.rotation, atol=1e-12)
        np.testing.assert_allclose(batch.jacobian[k], single.jacobian, atol=1e-12)


def test_task_error_vanishes_to_first_order_along_its_own_step(
    robot: Kinematics, limits: JointLimits
) -> None:
    rng = np.random.default_rng(3)
    for q in some(limits, 20, seed=1):
        state = robot.tip(q)
        position = state.position + rng.normal(size=3) * 1e-3
        axis = rotation_about(rng.normal(size=3), 1e-3) @ state.axis
        before = task_error(state, position, axis)
        if conditioning(state) < 0.05:
            continue
        step = damped_inverse(task_jacobian(state), 0.0) @ before
        after = task_error(robot.tip(q + step), position, axis)
        assert np.linalg.norm(after) < 0.1 * np.linalg.norm(before)


def test_error_of_opposite_axes_is_half_a_turn(robot: Kinematics) -> None:
    state = robot.tip(np.zeros(7))
    error = task_error(state, state.position, -state.axis)
    assert np.linalg.norm(error[3:]) == pytest.approx(np.pi)


def test_inverse_kinematics_round_trip_inside_the_limits(
    robot: Kinematics, limits: JointLimits
) -> None:
    box = limits.box(0.05)
    rng = np.random.default_rng(5)
    solved = 0
    for q in some(limits, 8, seed=2):
        wanted = robot.tip(q)
        found = solve(robot, box, box.sample(rng, 48), wanted.position, wanted.axis)
        assert box.contains(found).all()
        for answer in found:
            reached = robot.tip(answer)
            assert np.linalg.norm(reached.position - wanted.position) < 2e-4
            assert angle_between(reached.axis, wanted.axis) < 2e-4
        solved += len(found) > 0
    assert solved == 8


def test_out_of_reach_has_no_solutions(robot: Kinematics, limits: JointLimits) -> None:
    box = limits.box(0.05)
    seeds = box.sample(np.random.default_rng(0), 32)
    far, up = np.array([2.0, 0.0, 0.5]), np.array([0, 0, 1.0])
    assert len(solve(robot, box, seeds, far, up)) == 0


def test_following_a_line_stays_on_it(robot: Kinematics, limits: JointLimits) -> None:
    box = limits.box(0.05)
    start = np.array([0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4])
    tip = robot.tip(start)
    ways = np.linspace(0, 0.2, 11)
    positions = tip.position - np.outer(ways, [0, 0, 1.0])
    path = follow(robot, box, start[None], positions, np.tile(tip.axis, (11, 1)))
    assert path.error.max() < 1e-5
    reached = robot.tip(path.positions[0])
    np.testing.assert_allclose(reached.position, positions, atol=1e-5)


def test_a_joint_near_its_limit_hands_over_smoothly(robot: Kinematics, limits: JointLimits) -> None:
    """The incident: a joint that hit its limit stopped dead, the others jumped to take over.

    No slowing down can repair that: the acceleration at the kink has no bound.
    """
    box = limits.box(0.05)
    q = np.array([0.2, 0.1, -0.1, box.lower[3] + 0.4, 1.0, 1.4, 0.3])
    state = robot.tip(q)
    towards = task_jacobian(state)[:, 3] * -0.01
    steps = []
    for room in np.linspace(0.4, 1e-4, 200):
        near = q.copy()
        near[3] = box.lower[3] + room
        steps.append(limited_step(box, near, task_jacobian(robot.tip(near)), towards))
        assert box.contains(near + steps[-1])
    changes = np.abs(np.diff(steps, axis=0)).max(axis=1)
    assert abs(steps[-1][3]) < 1e-4 < abs(steps[0][3])
    # Between two of 200 positions a kink would change a step by its own size.
    assert changes.max() < 0.4 * np.abs(steps).max()


def test_wrong_names_list_the_right_ones(robot: Kinematics) -> None:
    with pytest.raises(ParameterError, match="panda_joint1"):
        Kinematics(robot.urdf, ["fr3_joint1"], robot.base_frame, robot.tip_frame)
    with pytest.raises(ParameterError, match=r"got cup.*suction_cup"):
        Kinematics(robot.urdf, robot.joint_names, robot.base_frame, "cup")
    with pytest.raises(ParameterError, match="moves with the arm"):
        Kinematics(robot.urdf, robot.joint_names, "panda_link3", robot.tip_frame)


def test_a_turned_base_frame_turns_all_poses(robot: Kinematics) -> None:
    urdf = robot.urdf.replace(
        '<link name="suction_tip"',
        '<link name="mount"/><joint name="mount_joint" type="fixed">'
        '<parent link="panda_link0"/><child link="mount"/>'
        '<origin xyz="0.1 0.2 0.3" rpy="0 0 0.5"/></joint><link name="suction_tip"',
        1,
    )
    other = Kinematics(urdf, robot.joint_names, "mount", robot.tip_frame)
    q = np.array([0.1, -0.5, 0.2, -2.0, 0.1, 1.5, 0.3])
    mount = np.eye(4)
    mount[:3, :3] = rotation_about((0, 0, 1), 0.5)
    mount[:3, 3] = 0.1, 0.2, 0.3
    np.testing.assert_allclose(mount @ other.pose(q), robot.pose(q), atol=1e-12)
    batch = other.tip(q[None])
    np.testing.assert_allclose(batch.position[0], other.tip(q).position, atol=1e-12)
    np.testing.assert_allclose(batch.jacobian[0], other.tip(q).jacobian, atol=1e-12)
    assert np.linalg.norm(unit(other.tip(q).axis)) == pytest.approx(1.0)
