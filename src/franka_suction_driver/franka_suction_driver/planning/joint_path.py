"""Smooth joint paths and their timing along the path parameter.

Corners are rounded by a cubic B-spline; Ruckig then times the path parameter such that the chain
rule keeps every joint within its velocity, acceleration and jerk limits.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline

from flowbothd_common.motion import JointState, JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.arm.trajectory import Profile, joint_move, move_to, sample_times

_DEGREE = 3
"""Degree of the spline: cubic, so that accelerations are continuous."""


class SmoothPath:
    """A twice continuously differentiable joint path q(s), 0 <= s <= length.

    Args:
        corners: (P, J) polyline, P >= 2; the first and the last point are met exactly.
        spacing: Distance between spline control points [rad]; corners are cut by about a third
            of it.
    """

    def __init__(self, corners: Array, spacing: float = 0.2) -> None:
        control = _control_points(np.asarray(corners, dtype=float), spacing)
        count = len(control)
        self.length = float(count - _DEGREE)
        inner = np.arange(1, count - _DEGREE)
        ends = (np.zeros(_DEGREE + 1), np.full(_DEGREE + 1, self.length))
        self._spline = BSpline(np.concatenate([ends[0], inner, ends[1]]), control, _DEGREE)
        self._derivatives = [self._spline.derivative(k) for k in (1, 2, 3)]

    def positions(self, s: Array) -> Array:
        """(K, J) configurations at path parameters (K,)."""
        return np.asarray(self._spline(np.clip(s, 0.0, self.length)))

    def samples(self, resolution: float) -> Array:
        """(K, J) configurations no further apart than about `resolution` [rad]."""
        speed = np.abs(self._derivatives[0](np.linspace(0, self.length, 200))).max()
        count = max(2, int(np.ceil(self.length * speed / resolution)) + 1)
        return self.positions(np.linspace(0, self.length, count))

    def timed(
        self, names: tuple[str, ...], limits: JointLimits, step: float = 0.025
    ) -> JointTrajectory:
        """The path from rest to rest within the limits, as fast as their bounds over it allow."""
        profile = self._parameter_profile(limits)
        times = sample_times(profile.duration, step)
        states = [profile.at(t) for t in times]
        s = np.clip(np.array([x.position[0] for x in states]), 0.0, self.length)
        rate = np.array([x.velocity for x in states])
        change = np.array([x.acceleration for x in states])
        first, second = self._derivatives[0](s), self._derivatives[1](s)
        velocities = first * rate
        accelerations = first * change + second * rate**2
        velocities[-1] = 0.0
        accelerations[-1] = 0.0
        positions = self.positions(s)
        positions[-1] = self.positions(np.array([self.length]))[0]
        return JointTrajectory(names, times, positions, velocities, accelerations)

    def _parameter_profile(self, limits: JointLimits) -> Profile:
        """Timing of s: each limit is shared out among the terms of the chain rule."""
        grid = np.linspace(0.0, self.length, max(200, int(20 * self.length)))
        d1, d2, d3 = (np.abs(d(grid)).max(axis=0) + 1e-9 for d in self._derivatives)
        speed = min(
            float((limits.velocity / d1).min()),
            float(np.sqrt(0.5 * limits.acceleration / d2).min()),
            float(np.cbrt(limits.jerk / (3 * d3)).min()),
        )
        change = float((0.5 * limits.acceleration / d1).min())
        change = min(change, float((limits.jerk / (9 * d2 * speed)).min()))
        jerk = float((limits.jerk / (3 * d1)).min())
        start = JointState.at_rest(np.zeros(1))
        bounds = (np.full(1, value) for value in (speed, change, jerk))
        return move_to(start, np.full(1, self.length), *bounds)


def stop_and_go(names: tuple[str, ...], corners: Array, limits: JointLimits) -> JointTrajectory:
    """Straight from corner to corner of a (P, J) polyline, with a stop at each."""
    parts = [joint_move(names, JointState.at_rest(a), b, limits) for a, b in pairwise(corners)]
    starts = np.cumsum([0.0, *(float(part.times[-1]) for part in parts)])
    return JointTrajectory(
        names,
        np.concatenate([part.times + start for part, start in zip(parts, starts, strict=False)]),
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.velocities for part in parts]),
        np.concatenate([part.accelerations for part in parts]),
    )


def _control_points(corners: Array, spacing: float) -> Array:
    """Points of the polyline at the spline's Greville abscissae: a straight path stays uniform."""
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    pieces = max(_DEGREE, int(np.ceil(along[-1] / spacing)))
    knots = np.concatenate([np.zeros(_DEGREE - 1), np.arange(pieces + 1), np.full(2, pieces)])
    greville = np.convolve(knots, np.ones(_DEGREE) / _DEGREE, mode="valid")
    wanted = np.concatenate([[0.0], greville[1:-1], [pieces]]) * along[-1] / pieces
    return np.column_stack([np.interp(wanted, along, column) for column in corners.T])
