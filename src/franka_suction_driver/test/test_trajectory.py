"""Timing: inside every limit, continuous where replaced, at rest in the end."""

from __future__ import annotations

import numpy as np
import pytest

from flowbothd_common.errors import ParameterError
from flowbothd_common.motion import JointState, JointTrajectory
from franka_suction_driver.arm.commanded_state import CommandedState
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits, limits_from
from franka_suction_driver.arm.trajectory import (
    joint_move,
    joint_stop,
    quintic,
    sample_times,
    state_at,
)
from franka_suction_driver.planning.joint_path import SmoothPath

NAMES = tuple(f"panda_joint{i}" for i in range(1, 8))


def assert_well_formed(trajectory: JointTrajectory) -> None:
    assert trajectory.times[0] > 0
    assert (np.diff(trajectory.times) > 0).all()
    assert not trajectory.velocities[-1].any()
    assert not trajectory.accelerations[-1].any()


def test_random_moves_stay_within_every_limit(limits: JointLimits) -> None:
    rng = np.random.default_rng(0)
    box = limits.box(0.05)
    for _ in range(200):
        start, goal = box.sample(rng, 2)
        scaled = limits.scaled(float(rng.uniform(0.05, 1.0)))
        trajectory = joint_move(NAMES, JointState.at_rest(start), goal, scaled)
        assert_well_formed(trajectory)
        assert scaled.violation(trajectory) is None
        np.testing.assert_allclose(trajectory.positions[-1], goal, atol=1e-9)


def test_moves_from_rest_are_straight_in_joint_space(limits: JointLimits) -> None:
    start, goal = limits.box(0.05).sample(np.random.default_rng(4), 2)
    trajectory = joint_move(NAMES, JointState.at_rest(start), goal, limits)
    along = unit_vector(goal - start)
    offsets = trajectory.positions - start
    across = offsets - np.outer(offsets @ along, along)
    assert np.abs(across).max() < 1e-6


def unit_vector(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def test_slower_takes_longer(limits: JointLimits) -> None:
    start, goal = limits.box(0.05).sample(np.random.default_rng(7), 2)
    times = [
        joint_move(NAMES, JointState.at_rest(start), goal, limits.scaled(s)).times[-1]
        for s in (1.0, 0.5, 0.1)
    ]
    assert times[0] < times[1] < times[2]


def test_replacement_is_continuous_and_stop_comes_to_rest(limits: JointLimits) -> None:
    """At any moment of any motion a stop, or another goal, continues the commanded state."""
    rng = np.random.default_rng(1)
    box = limits.box(0.3)
    for _ in range(100):
        start, goal, other = box.sample(rng, 3)
        commanded_state = CommandedState()
        commanded_state.reset(start)
        first = joint_move(NAMES, JointState.at_rest(start), goal, limits)
        commanded_state.issue(first, 10.0)
        when = 10.0 + float(rng.uniform(0, first.times[-1]))
        before = commanded_state.state(when)
        if rng.random() < 0.5:
            second = joint_stop(NAMES, before, limits)
        else:
            second = joint_move(NAMES, before, other, limits)
        assert_well_formed(second)
        commanded_state.issue(second, when)
        after = commanded_state.state(when)
        np.testing.assert_allclose(after.position, before.position, atol=1e-12)
        np.testing.assert_allclose(after.velocity, before.velocity, atol=1e-12)
        np.testing.assert_allclose(after.acceleration, before.acceleration, atol=1e-9)
        # Just after the change nothing has jumped either.
        later = commanded_state.state(when + 1e-4)
        assert np.abs(later.velocity - before.velocity).max() < 1e-2
        end = commanded_state.state(when + float(second.times[-1]) + 1)
        assert not end.velocity.any()
        assert commanded_state.finished(when + float(second.times[-1]) + 1e-6)


def test_interpolation_reproduces_the_points(limits: JointLimits) -> None:
    start, goal = limits.box(0.05).sample(np.random.default_rng(2), 2)
    entered = JointState.at_rest(start)
    trajectory = joint_move(NAMES, entered, goal, limits)
    for k in (0, 5, len(trajectory.times) - 1):
        state = state_at(trajectory, entered, float(trajectory.times[k]) - 1e-9)
        np.testing.assert_allclose(state.position, trajectory.positions[k], atol=1e-6)
        np.testing.assert_allclose(state.velocity, trajectory.velocities[k], atol=1e-5)


def test_quintic_meets_both_ends() -> None:
    rng = np.random.default_rng(0)
    before, after = (JointState(*rng.normal(size=(3, 4))) for _ in range(2))
    for state, time in ((before, 0.0), (after, 0.3)):
        met = quintic(before, after, 0.3, time)
        np.testing.assert_allclose(met.position, state.position, atol=1e-9)
        np.testing.assert_allclose(met.velocity, state.velocity, atol=1e-8)
        np.testing.assert_allclose(met.acceleration, state.acceleration, atol=1e-6)


def test_sample_times_end_exactly() -> None:
    for duration in (0.0, 1e-4, 0.025, 0.7, 3.3333):
        times = sample_times(duration)
        assert times[0] > 0
        assert times[-1] == pytest.approx(max(duration, 0.025), abs=1e-12)
        assert np.diff(times, prepend=0).max() <= 0.025 + 1e-12


def test_smooth_paths_are_within_limits_and_meet_their_ends(limits: JointLimits) -> None:
    rng = np.random.default_rng(0)
    for _ in range(60):
        corners = limits.box(0.1).sample(rng, int(rng.integers(2, 6)))
        path = SmoothPath(corners, 0.2)
        trajectory = path.timed(NAMES, limits)
        assert_well_formed(trajectory)
        assert limits.violation(trajectory) is None
        np.testing.assert_allclose(path.positions(np.zeros(1))[0], corners[0], atol=1e-9)
        np.testing.assert_allclose(trajectory.positions[-1], corners[-1], atol=1e-9)


def test_a_smooth_path_stays_near_its_corners(limits: JointLimits) -> None:
    corners = np.zeros((3, 7))
    corners[1, 0] = corners[2, 0] = corners[2, 1] = 1.0
    for spacing in (0.3, 0.1):
        samples = SmoothPath(corners, spacing).samples(0.01)
        to_first = np.hypot(np.clip(samples[:, 0] - 1, None, 0), samples[:, 1])
        nearest = np.minimum(np.abs(samples[:, 1]), np.abs(samples[:, 0] - 1))
        assert nearest.max() < 0.5 * spacing
        assert len(to_first) == len(samples)


def test_violations_name_joint_amount_and_limit(limits: JointLimits) -> None:
    times = np.array([0.1, 0.2])
    zero = np.zeros((2, 7))
    fast = zero.copy()
    fast[0, 2] = 9.0
    trajectory = JointTrajectory(NAMES, times, zero - [0, 0, 0, 1, 0, -1, 0], fast, zero)
    violation = limits.violation(trajectory)
    assert violation is not None
    assert "velocity of panda_joint3" in str(violation)
    assert violation.ratio == pytest.approx(9.0 / limits.velocity[2])
    jerky = JointTrajectory(NAMES, times, zero - [0, 0, 0, 1, 0, -1, 0], zero, np.eye(2, 7))
    assert "jerk" not in str(limits.violation(jerky))
    jumping = JointTrajectory(
        NAMES, times / 1000, zero - [0, 0, 0, 1, 0, -1, 0], zero, np.eye(2, 7)
    )
    assert "jerk of panda_joint1" in str(limits.violation(jumping))


def test_limits_must_fit_the_robot(robot: Kinematics) -> None:
    with pytest.raises(ParameterError, match=r"acceleration limits.*7 values"):
        limits_from(robot, [1.0] * 6, [500.0] * 7)
    with pytest.raises(ParameterError, match=r"jerk limits.*> 0"):
        limits_from(robot, [1.0] * 7, [500.0] * 6 + [0.0])
    with pytest.raises(ParameterError, match="speed scale"):
        limits_from(robot, [1.0] * 7, [500.0] * 7).scaled(1.5)


def test_an_unknown_commanded_state_is_an_error() -> None:
    with pytest.raises(RuntimeError, match="call reset"):
        CommandedState().state(0.0)
