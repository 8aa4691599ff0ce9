"""The trajectory follower keeps the controller's rules."""

import numpy as np
import pytest

from flowbothd_common.motion import JointTrajectory
from flowbothd_common.trajectory_continuity import discontinuity
from sim_bridge.trajectory import TrajectoryFollower

NAMES = ("a", "b")
NONE = np.zeros((0, 2))


def trajectory(times, positions, velocities=None, accelerations=None, names=NAMES):
    positions = np.asarray(positions, dtype=float)
    zero = np.zeros_like(positions)
    return JointTrajectory(
        names,
        np.asarray(times, dtype=float),
        positions,
        zero if velocities is None else np.asarray(velocities, dtype=float),
        zero if accelerations is None else np.asarray(accelerations, dtype=float),
    )


@pytest.fixture
def follower():
    return TrajectoryFollower(NAMES, np.array([0.1, -0.2]))


def differences(follower, start, end, order):
    """Largest jump of the n-th derivative between dense samples."""
    times = np.arange(start, end, 1e-4)
    samples = [follower.sample(t) for t in times]
    values = np.array([[s.position, s.velocity, s.acceleration][order] for s in samples])
    return np.abs(np.diff(values, axis=0)).max()


def test_it_rests_where_it_is_put(follower):
    assert np.array_equal(follower.sample(3.0).position, [0.1, -0.2])
    assert not follower.active(3.0)


def test_velocities_and_accelerations_are_the_derivatives(follower):
    points = trajectory(
        [0.5, 1.2], [[0.5, 0.0], [0.7, 0.3]], [[0.4, 0.2], [0, 0]], [[0.1, -0.3], [0, 0]]
    )
    assert follower.accept(points, now=2.0) == ""
    h = 1e-6
    for t in (2.1, 2.49, 2.51, 2.9, 3.19):
        before, here, after = (follower.sample(t + d) for d in (-h, 0, h))
        slope = (after.position - before.position) / (2 * h)
        bend = (after.velocity - before.velocity) / (2 * h)
        assert np.allclose(slope, here.velocity, atol=1e-6)
        assert np.allclose(bend, here.acceleration, atol=1e-5)
    middle = follower.sample(2.5)
    assert np.allclose(middle.position, [0.5, 0.0])
    assert np.allclose(middle.velocity, [0.4, 0.2])
    assert np.allclose(middle.acceleration, [0.1, -0.3])
    end = follower.sample(10.0)
    assert np.allclose(end.position, [0.7, 0.3])
    assert not end.velocity.any()


def test_a_replacement_is_continuous_with_what_was_commanded(follower):
    follower.accept(trajectory([1.0], [[1.0, 1.0]]), now=0.0)
    before = follower.sample(0.4)
    assert np.abs(before.velocity).max() > 0.5
    assert follower.accept(trajectory([1.0], [[0.2, 0.0]]), now=0.4) == ""
    after = follower.sample(0.4)
    assert np.allclose(before.position, after.position)
    assert np.allclose(before.velocity, after.velocity)
    assert np.allclose(before.acceleration, after.acceleration)
    assert differences(follower, 0.3, 1.6, order=0) < 5e-4
    assert np.allclose(follower.sample(1.4).position, [0.2, 0.0])


def test_cubic_and_linear_where_less_is_given(follower):
    cubic = JointTrajectory(NAMES, np.array([1.0]), np.array([[1.1, -0.2]]), np.zeros((1, 2)), NONE)
    assert follower.accept(cubic, now=0.0) == ""
    assert follower.sample(0.25).position[0] == pytest.approx(0.1 + 3 / 16 - 2 / 64)
    linear = JointTrajectory(NAMES, np.array([1.0]), np.array([[1.1, -0.2]]), NONE, NONE)
    follower.reset(np.array([0.1, -0.2]))
    assert follower.accept(linear, now=0.0) == ""
    assert follower.sample(0.25).position[0] == pytest.approx(0.35)


def test_joints_are_found_by_name(follower):
    swapped = trajectory([1.0], [[2.0, 1.0]], names=("b", "a"))
    assert follower.accept(swapped, now=0.0) == ""
    assert np.allclose(follower.sample(1.0).position, [1.0, 2.0])


def test_a_stamp_in_the_past_skips_what_has_passed(follower):
    points = trajectory([1.0, 2.0], [[1.0, 0.0], [0.6, 0.0]])
    assert follower.accept(points, now=5.0, stamp=3.5) == ""
    assert np.allclose(follower.sample(5.0).position, [0.1, -0.2])
    assert np.allclose(follower.sample(5.5).position, [0.6, 0.0])


def test_a_stamp_in_the_future_waits(follower):
    assert follower.accept(trajectory([1.0], [[1.0, 0.0]]), now=5.0, stamp=6.0) == ""
    assert np.allclose(follower.sample(7.0).position, [1.0, 0.0])
    assert follower.active(6.9)


def test_a_first_point_at_zero_replaces_the_present_state(follower):
    points = trajectory([0.0, 1.0], [[0.11, -0.19], [0.5, 0.5]])
    assert follower.accept(points, now=1.0) == ""
    assert np.allclose(follower.sample(1.0).position, [0.11, -0.19])


@pytest.mark.parametrize("times", [[0.0, 1.0], [0.04, 1.0]])
def test_one_that_begins_elsewhere_is_refused_and_the_joints_come_to_rest(follower, times):
    """The incident: the arm was held, its reference ran on, and it snapped after it at 23 rad/s."""
    follower.accept(trajectory([1.0], [[1.0, 1.0]]), now=0.0)
    moving = follower.sample(0.4)
    away = moving.position + np.array([1.0, 0.0])
    reason = follower.accept(trajectory(times, [away, away]), now=0.4)
    assert "a would leap by" in reason
    assert differences(follower, 0.3, 1.0, order=0) < 5e-4
    rest = follower.sample(1.0)
    assert not rest.velocity.any()
    assert np.abs(rest.position - moving.position).max() < 0.25
    # From where it stands it goes on.
    assert follower.accept(trajectory([1.0], [rest.position + 0.1]), now=1.0) == ""


@pytest.mark.parametrize("lead", [0.0, 0.025, 0.1, 0.4])
def test_no_motion_within_the_limits_is_taken_for_a_leap(lead):
    """Speeding up for half of the time, then slowing down, leads furthest off the mean speed."""
    acceleration, speed = 10.0, np.array([0.7])
    furthest = speed * lead + acceleration * lead**2 / 4

    def verdict(first):
        play = {"tolerance": 1e-9, "acceleration": acceleration}
        return discontinuity(("a",), (np.zeros(1), speed), (first, speed), lead, **play)

    assert verdict(furthest) == ""
    assert "a would leap by" in verdict(furthest + 0.01)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (trajectory([1.0], [[0, 0]], names=("a", "c")), "unknown joints ['c']"),
        (trajectory([1.0], [[0.0]], names=("a",)), "1 joints given"),
        (trajectory([1.0], [[0.0, 0.0]], names=("a", "a")), "all of ['a', 'b'] are needed"),
        (trajectory([], np.zeros((0, 2))), "no points"),
        (trajectory([1.0, 1.0], [[0, 0], [1, 1]]), "not strictly increasing"),
        (trajectory([-1.0], [[0, 0]]), "not strictly increasing"),
        (trajectory([1.0], [[0, 0]], [[0.1, 0]]), "last velocity is 0.1 rad/s"),
        (trajectory([1.0], [[0, np.nan]]), "not finite"),
        (trajectory([1.0], [[0, 0]], [[0, 0]], [[np.inf, 0]]), "accelerations are not finite"),
        (trajectory([1.0], [[0, 0]], [[0, 0], [0, 0]]), "velocities are (2, 2)"),
        (trajectory([1.0, 2.0], [[0, 0]]), "positions are (1, 2)"),
    ],
)
def test_rejections_name_the_reason_and_leave_the_old_one_running(follower, bad, words):
    follower.accept(trajectory([1.0], [[1.0, 1.0]]), now=0.0)
    before = follower.sample(0.5).position
    reason = follower.accept(bad, now=0.2)
    assert words in reason
    assert np.array_equal(follower.sample(0.5).position, before)


def test_a_trajectory_that_is_over_is_rejected(follower):
    reason = follower.accept(trajectory([1.0], [[1, 1]]), now=5.0, stamp=3.5)
    assert "ended 0.500 s ago" in reason


def test_hold_stops_smoothly_and_forgets(follower):
    follower.accept(trajectory([1.0], [[1.0, 1.0]]), now=0.0)
    moving = follower.sample(0.5)
    follower.hold(0.5)
    assert np.allclose(follower.sample(0.5).velocity, moving.velocity)
    assert differences(follower, 0.4, 0.8, order=1) < 0.01
    stopped = follower.sample(0.5 + follower.hold_time)
    assert not stopped.velocity.any()
    # It overran by less than it would have travelled at the speed that it had.
    overrun = np.abs(stopped.position - moving.position)
    assert (overrun < np.abs(moving.velocity) * follower.hold_time).all()
    assert np.array_equal(follower.sample(9.0).position, stopped.position)
