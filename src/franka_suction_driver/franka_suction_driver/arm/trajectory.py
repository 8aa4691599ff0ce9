"""Jerk-limited timing: joint motions by Ruckig, and the interpolation that controllers do.

Every trajectory starts after its first sampling step, carries positions, velocities and
accelerations, and ends at rest: what a JointTrajectoryController needs to follow it without a
jump.
"""

from __future__ import annotations

import numpy as np
import ruckig

from flowbothd_common.errors import FlowBotError
from flowbothd_common.motion import JointState, JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.arm.trajectory_check import fine_violation

SAMPLE = 0.025
"""Time between two points of a trajectory [s]."""
_INTERPOLATED = (0.995, 0.88, 0.5)
"""Parts of the velocity, acceleration and jerk limits that joint profiles are made with: the
quintics between samples of a jerk that jumps overshoot them."""
_STOP_STEPS = (SAMPLE, SAMPLE / 2, SAMPLE / 4)
"""Times between the points of a stop to try [s]: closer points leave quintics less room to
overshoot a limit."""


class TimingError(FlowBotError):
    """No motion within the limits connects the two states."""


class Profile:
    """A jerk-limited motion of one or more coordinates; a Ruckig trajectory with a clock.

    Attributes:
        duration: [s].
    """

    def __init__(self, trajectory: ruckig.Trajectory) -> None:
        self._trajectory = trajectory
        self.duration = float(trajectory.duration)

    def at(self, time: float) -> JointState:
        """State at `time` [s]; at rest, or moving on, after the end."""
        position, velocity, acceleration = self._trajectory.at_time(max(0.0, time))
        return JointState(np.array(position), np.array(velocity), np.array(acceleration))

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations, (T, D) each, at `times` (T,) [s].

        At rest before the start and after the end, whatever rounding says.
        """
        clipped = np.clip(times, 0.0, self.duration)
        rows = np.array([self._trajectory.at_time(t) for t in clipped.tolist()])
        rows = rows.reshape(len(clipped), 3, -1)
        rows[times >= self.duration, 1:] = 0.0
        return rows[:, 0], rows[:, 1], rows[:, 2]


def move_to(
    start: JointState,
    goal: Array,
    velocity: Array,
    acceleration: Array,
    jerk: Array,
    *,
    straight: bool = False,
) -> Profile:
    """Fastest motion to rest at `goal` within symmetric limits; all arrays (D,).

    Args:
        start: Where and how the coordinates move now.
        goal: Where to come to rest.
        velocity: Limits.
        acceleration: Limits.
        jerk: Limits.
        straight: All coordinates keep in phase, so that from rest the path is a straight line.

    Raises:
        TimingError: the start already breaks the limits beyond repair.
    """
    request = _request(start, velocity, acceleration, jerk)
    request.target_position = np.asarray(goal, dtype=float).tolist()
    if straight:
        request.synchronization = ruckig.Synchronization.Phase
    return _solve(request)


def brake(start: JointState, acceleration: Array, jerk: Array) -> Profile:
    """Fastest stop from any state within the limits, (D,) each."""
    request = _request(start, np.maximum(np.abs(start.velocity), 1e-3) * 2, acceleration, jerk)
    request.control_interface = ruckig.ControlInterface.Velocity
    request.target_velocity = [0.0] * len(start.position)
    request.synchronization = ruckig.Synchronization.No
    return _solve(request)


def joint_move(
    names: tuple[str, ...], start: JointState, goal: Array, limits: JointLimits
) -> JointTrajectory:
    """Jerk-limited motion to rest at `goal` (J,); straight in joint space if it starts at rest."""
    at_rest = not (start.velocity.any() or start.acceleration.any())
    profile = move_to(start, goal, *interpolable(limits), straight=at_rest)
    return sampled(names, profile)


def joint_stop(names: tuple[str, ...], start: JointState, limits: JointLimits) -> JointTrajectory:
    """Fastest stop of all joints within the limits.

    Where a controller's quintics would overshoot a limit between two points, the points are set
    closer: from hard manoeuvres at full acceleration they overshot by a hundredth.
    """
    profile = brake(start, *interpolable(limits)[1:])
    for step in _STOP_STEPS[:-1]:
        trajectory = sampled(names, profile, step)
        if fine_violation(limits, trajectory, start) is None:
            return trajectory
    return sampled(names, profile, _STOP_STEPS[-1])


def interpolable(limits: JointLimits) -> tuple[Array, Array, Array]:
    """Velocity, acceleration and jerk limits of profiles that quintics are laid through."""
    velocity, acceleration, jerk = _INTERPOLATED
    return velocity * limits.velocity, acceleration * limits.acceleration, jerk * limits.jerk


def sampled(names: tuple[str, ...], profile: Profile, step: float = SAMPLE) -> JointTrajectory:
    """The profile as a trajectory with a point every `step` seconds, the last at rest."""
    times = sample_times(profile.duration, step)
    states = [profile.at(t) for t in times]
    velocities = np.array([s.velocity for s in states])
    accelerations = np.array([s.acceleration for s in states])
    # The end is at rest up to rounding; controllers compare with exactly zero.
    velocities[-1] = 0.0
    accelerations[-1] = 0.0
    positions = np.array([s.position for s in states])
    return JointTrajectory(names, times, positions, velocities, accelerations)


def sample_times(duration: float, step: float = SAMPLE) -> Array:
    """Evenly spaced times in (0, duration], about `step` apart, ending exactly at the duration."""
    duration = max(duration, step)
    count = max(1, int(np.ceil(duration / step - 1e-9)))
    return np.linspace(duration / count, duration, count)


def state_at(trajectory: JointTrajectory, start: JointState, time: float) -> JointState:
    """What a controller commands `time` seconds after it took over the trajectory.

    Quintic between points, from `start` before the first, at rest at the last after the end.
    """
    times = trajectory.times
    if time >= times[-1]:
        return JointState.at_rest(trajectory.positions[-1])
    k = int(np.searchsorted(times, time, side="right"))
    after = JointState(
        trajectory.positions[k], trajectory.velocities[k], trajectory.accelerations[k]
    )
    if k == 0:
        return quintic(start, after, float(times[0]), time)
    before = JointState(
        trajectory.positions[k - 1], trajectory.velocities[k - 1], trajectory.accelerations[k - 1]
    )
    return quintic(before, after, float(times[k] - times[k - 1]), time - float(times[k - 1]))


def quintic(before: JointState, after: JointState, duration: float, time: float) -> JointState:
    """State at `time` on the polynomial that meets both states, `duration` [s] apart."""
    h = duration
    p0, v0, a0 = before.position, before.velocity * h, before.acceleration * h * h
    p1, v1, a1 = after.position, after.velocity * h, after.acceleration * h * h
    c3 = 10 * (p1 - p0) - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15 * (p1 - p0) + 8 * v0 + 7 * v1 + 1.5 * a0 - a1
    c5 = 6 * (p1 - p0) - 3 * v0 - 3 * v1 - 0.5 * a0 + 0.5 * a1
    u = time / h
    position = p0 + u * (v0 + u * (a0 / 2 + u * (c3 + u * (c4 + u * c5))))
    velocity = v0 + u * (a0 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))
    acceleration = a0 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5))
    return JointState(position, velocity / h, acceleration / (h * h))


def _request(
    start: JointState, velocity: Array, acceleration: Array, jerk: Array
) -> ruckig.InputParameter:
    request = ruckig.InputParameter(len(start.position))
    request.current_position = start.position.tolist()
    request.current_velocity = start.velocity.tolist()
    request.current_acceleration = start.acceleration.tolist()
    request.max_velocity = velocity.tolist()
    request.max_acceleration = acceleration.tolist()
    request.max_jerk = jerk.tolist()
    return request


def _solve(request: ruckig.InputParameter) -> Profile:
    trajectory = ruckig.Trajectory(request.degrees_of_freedom)
    result = ruckig.Ruckig(request.degrees_of_freedom).calculate(request, trajectory)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise TimingError(
            "no jerk-limited motion connects the states",
            got=f"{result}: from {request.current_position} to {request.target_position}",
            hint="the start lies outside the velocity or acceleration limits",
        )
    return Profile(trajectory)
