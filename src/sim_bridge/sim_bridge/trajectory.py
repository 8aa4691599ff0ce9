"""Follows joint trajectories as ros2_control's JointTrajectoryController takes them."""

from __future__ import annotations

import numpy as np

from flowbothd_common.motion import JointState, JointTrajectory, joint_order
from flowbothd_common.trajectory_continuity import discontinuity
from flowbothd_common.types import Array

_REST_TOLERANCE = 1.2e-7
"""Largest end velocity that the controller takes for rest [rad/s]."""

_ACCELERATION = 10.0
"""What a motion ahead may need of any joint [rad/s^2]; an arm's limits are about this."""


class TrajectoryFollower:
    """Interpolates the newest accepted trajectory; starts at rest.

    A new trajectory replaces the old one and starts from the commanded state, whatever that is
    (interpolate_from_desired_state). Between points: quintic where positions, velocities and
    accelerations are given, cubic with positions and velocities, linear with positions only; an
    array of size 0 counts as not given.

    Other than the controller, it refuses one that begins elsewhere, and comes to rest: whoever sent
    it has lost track of the arm.
    """

    def __init__(
        self,
        joint_names: tuple[str, ...],
        positions: Array,
        hold_time: float = 0.15,
        start_tolerance: float = 0.03,
    ) -> None:
        """Hold `positions` (J,).

        Args:
            joint_names: J names.
            positions: Where the joints are [rad].
            hold_time: Time in which `hold` brings the joints to rest [s].
            start_tolerance: Largest distance of the first point from the commanded state [rad].
        """
        self.joint_names = joint_names
        self.hold_time = hold_time
        self.start_tolerance = start_tolerance
        self.reset(positions)

    def reset(self, positions: Array) -> None:
        """Forget everything and hold `positions` (J,)."""
        zero = np.zeros(len(self.joint_names))
        self._rest = JointState(np.array(positions, dtype=float), zero, zero)
        self._times: Array = np.zeros(0)
        self._points: list[JointState] = []
        self._order = 5

    def accept(self, trajectory: JointTrajectory, now: float, stamp: float = 0.0) -> str:
        """Take over a trajectory.

        Args:
            trajectory: Any order of joints, but exactly ours.
            now: Present time [s].
            stamp: When it starts [s]; 0 = now. What lies before now is skipped.

        Returns:
            Empty if accepted; else why not. The old trajectory goes on, unless the new one begins
            elsewhere: then the joints come to rest.
        """
        reason = self._objection(trajectory, now, stamp)
        if reason:
            return reason
        columns = joint_order(self.joint_names, trajectory.joint_names)
        times = np.asarray(trajectory.times, dtype=float) + (stamp or now)
        count, joints = len(times), len(columns)
        velocities = _given(trajectory.velocities, count, columns)
        accelerations = _given(trajectory.accelerations, count, columns)
        order = 1 if velocities is None else (3 if accelerations is None else 5)
        zero = np.zeros((count, joints))
        rows = zip(
            np.asarray(trajectory.positions, dtype=float)[:, columns],
            zero if velocities is None else velocities,
            zero if accelerations is None else accelerations,
            strict=True,
        )
        points = [JointState(*row) for row in rows]
        keep = times > now
        elsewhere = self._leap(times, points, now, moving=order > 1)
        if elsewhere:
            self.hold(now)
            return elsewhere
        # A first point at the very start replaces the present state, as the controller does it.
        if times[0] == now:
            self._times, self._points = times, points
        else:
            present = self.sample(now)
            self._times = np.concatenate([[now], times[keep]])
            self._points = [present] + [p for p, k in zip(points, keep, strict=True) if k]
        self._order = order
        self._rest = JointState(points[-1].position, np.zeros(joints), np.zeros(joints))
        return ""

    def hold(self, now: float) -> None:
        """Come to rest within `hold_time`, smoothly, and forget the trajectory."""
        present = self.sample(now)
        joints = np.zeros(len(self.joint_names))
        stop = present.position + 0.5 * self.hold_time * present.velocity
        self._rest = JointState(stop, joints, joints)
        self._times = np.array([now, now + self.hold_time])
        self._points = [present, self._rest]
        self._order = 5

    def active(self, now: float) -> bool:
        """True until the trajectory has ended."""
        return bool(len(self._times)) and now < float(self._times[-1])

    def sample(self, now: float) -> JointState:
        """The commanded state at `now`."""
        if not self.active(now):
            return self._rest
        after = int(np.searchsorted(self._times, now, side="right"))
        if after == 0:
            return self._points[0]
        start, end = self._points[after - 1], self._points[after]
        begin = float(self._times[after - 1])
        return _interpolate(start, end, now - begin, float(self._times[after]) - begin, self._order)

    def _leap(self, times: Array, points: list[JointState], now: float, *, moving: bool) -> str:
        """Why the first point ahead does not go on from the commanded state, or nothing."""
        present, ahead = self.sample(now), int(np.searchsorted(times, now))
        first = points[ahead]
        return discontinuity(
            self.joint_names,
            (present.position, present.velocity),
            (first.position, first.velocity if moving else present.velocity),
            float(times[ahead]) - now,
            tolerance=self.start_tolerance,
            acceleration=_ACCELERATION,
        )

    def _objection(self, trajectory: JointTrajectory, now: float, stamp: float) -> str:
        names, times = trajectory.joint_names, np.asarray(trajectory.times, dtype=float)
        positions = np.asarray(trajectory.positions, dtype=float)
        unknown = [name for name in names if name not in self.joint_names]
        if unknown:
            return f"unknown joints {unknown}; allowed: {list(self.joint_names)}"
        if sorted(names) != sorted(self.joint_names):
            return f"{len(names)} joints given, all of {list(self.joint_names)} are needed, once"
        if not len(times):
            return "the trajectory has no points"
        if positions.shape != (len(times), len(names)):
            return f"positions are {positions.shape}, needed are {(len(times), len(names))}"
        for label, values in (
            ("velocities", trajectory.velocities),
            ("accelerations", trajectory.accelerations),
        ):
            if np.size(values) and np.shape(values) != positions.shape:
                return f"{label} are {np.shape(values)}, needed are {positions.shape} or none"
            if not np.isfinite(values).all():
                return f"{label} are not finite"
        if not (np.isfinite(positions).all() and np.isfinite(times).all()):
            return "positions or times are not finite"
        if times[0] < 0 or (np.diff(times) <= 0).any():
            return "times are not strictly increasing from 0"
        last = np.asarray(trajectory.velocities)[-1] if np.size(trajectory.velocities) else 0.0
        if (np.abs(last) > _REST_TOLERANCE).any():
            return f"the last velocity is {np.abs(last).max():.3g} rad/s, it must be zero"
        if stamp and stamp + float(times[-1]) < now:
            return f"the trajectory ended {now - stamp - float(times[-1]):.3f} s ago"
        return ""


def _given(values: Array, count: int, columns: list[int]) -> Array | None:
    array = np.asarray(values, dtype=float)
    return array.reshape(count, -1)[:, columns] if array.size else None


def _interpolate(
    start: JointState, end: JointState, t: float, duration: float, order: int
) -> JointState:
    p0, p1, v0, v1 = start.position, end.position, start.velocity, end.velocity
    d = duration
    if order == 1:
        slope = (p1 - p0) / d
        return JointState(p0 + slope * t, slope, np.zeros_like(slope))
    if order == 3:
        c2 = (3 * (p1 - p0) - (2 * v0 + v1) * d) / d**2
        c3 = (2 * (p0 - p1) + (v0 + v1) * d) / d**3
        zero = np.zeros_like(c2)
        coefficients = (p0, v0, c2, c3, zero, zero)
    else:
        a0, a1 = start.acceleration, end.acceleration
        h = p1 - p0
        c3 = (20 * h - (8 * v1 + 12 * v0) * d - (3 * a0 - a1) * d**2) / (2 * d**3)
        c4 = (-30 * h + (14 * v1 + 16 * v0) * d + (3 * a0 - 2 * a1) * d**2) / (2 * d**4)
        c5 = (12 * h - 6 * (v1 + v0) * d + (a1 - a0) * d**2) / (2 * d**5)
        coefficients = (p0, v0, a0 / 2, c3, c4, c5)
    k0, k1, k2, k3, k4, k5 = coefficients
    return JointState(
        k0 + t * (k1 + t * (k2 + t * (k3 + t * (k4 + t * k5)))),
        k1 + t * (2 * k2 + t * (3 * k3 + t * (4 * k4 + t * 5 * k5))),
        2 * k2 + t * (6 * k3 + t * (12 * k4 + t * 20 * k5)),
    )
