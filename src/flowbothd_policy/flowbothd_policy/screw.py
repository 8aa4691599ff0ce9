"""The rigid motion without pitch that explains a flow field around one point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.types import ArcKind, Array, Cloud, JointArc

_MOVING = 0.1
_NEIGHBOURS = 40
_ROUNDS = 8
_MIN_INLIERS = 12


@dataclass(frozen=True)
class Screw:
    """A line or arc motion fitted to max-normalised flow.

    Attributes:
        arc: The motion; the axis of an arc turns the part the way the flow points.
        rate: Flow norm per unit of motion: at 1 m from an arc's axis, or anywhere for a line.
        residual: Root mean square over the inliers of the norm of what is not explained.
        inliers: Points that move with it.
    """

    arc: JointArc
    rate: float
    residual: float
    inliers: int

    def flow_at(self, point: Array) -> Array:
        """(3,) flow that the motion gives at a point in base, max-normalised."""
        if self.arc.kind is ArcKind.LINE:
            return self.rate * self.arc.axis
        return np.asarray(self.rate * np.cross(self.arc.axis, point - self.arc.point))

    def radius_at(self, point: Array) -> float:
        """Distance of a point from the axis of an arc [m]; infinite for a line."""
        if self.arc.kind is ArcKind.LINE:
            return float("inf")
        return float(np.linalg.norm(np.cross(self.arc.axis, point - self.arc.point)))


def fit_screw(points: Cloud, flow: NDArray[np.float32], near: Array) -> Screw | None:
    """Fit the motion of the part around `near`, leaving out other parts and outliers.

    The fit starts from the moving points nearest to `near` and takes in whatever moves with
    them, so that a cabinet whose other doors move too still gives the one door's hinge.

    Args:
        points: (N, 3) in base [m].
        flow: (N, 3) max-normalised.
        near: (3,) where the part will be held [m].

    Returns:
        The motion, or None where fewer than a dozen points move together.
    """
    moving = np.linalg.norm(flow, axis=1) > _MOVING
    p = points[moving].astype(float) - near
    f = flow[moving].astype(float)
    if len(p) < _MIN_INLIERS:
        return None
    inliers = _grow(p, f)
    if inliers is None:
        return None
    p, f = p[inliers], f[inliers]
    line = np.mean(f, axis=0)
    line_error = _rms(f - line)
    twist = _twist(p, f)
    turning = _without_pitch(twist)
    # A twist always fits at least as well as a line: it must earn its three further numbers.
    if turning is None or line_error**2 <= 1.1 * _rms(f - _field(turning, p)) ** 2 + 2.5e-3:
        rate = float(np.linalg.norm(line))
        if rate < _MOVING:
            return None
        return Screw(JointArc(ArcKind.LINE, line / rate, np.zeros(3)), rate, line_error, len(p))
    omega, v = turning[:3], turning[3:]
    rate = float(np.linalg.norm(omega))
    foot = np.cross(omega, v) / rate**2 + near
    error = _rms(f - _field(turning, p))
    return Screw(JointArc(ArcKind.ARC, omega / rate, foot), rate, error, len(p))


def _grow(p: Array, f: Array) -> NDArray[np.bool_] | None:
    nearest = np.argsort(np.linalg.norm(p, axis=1), kind="stable")[:_NEIGHBOURS]
    # The neighbourhood is too small to tell a rotation from noise; as a translation it finds
    # the points that move alike, and their wider base then tells.
    model = np.concatenate([np.zeros(3), np.median(f[nearest], axis=0)])
    threshold = 0.3
    inliers = np.zeros(len(p), dtype=bool)
    for _ in range(_ROUNDS):
        residual = np.linalg.norm(f - _field(model, p), axis=1)
        grown = residual < threshold
        if np.count_nonzero(grown) < _MIN_INLIERS:
            return None
        if np.array_equal(grown, inliers):
            break
        inliers = grown
        model = _twist(p[inliers], f[inliers])
        threshold = float(np.clip(3 * np.median(residual[inliers]), 0.1, 0.3))
    return inliers


def _field(twist: Array, p: Array) -> Array:
    return np.asarray(twist[3:] + np.cross(twist[:3], p))


def _twist(p: Array, f: Array) -> Array:
    """(6,) angular and linear rate at the origin, in the least squares sense."""
    scale = max(float(np.sqrt(np.mean(p**2))), 1e-6)
    q = p / scale
    rows = np.zeros((len(q), 3, 6))
    rows[:, 0, 1], rows[:, 0, 2] = q[:, 2], -q[:, 1]
    rows[:, 1, 0], rows[:, 1, 2] = -q[:, 2], q[:, 0]
    rows[:, 2, 0], rows[:, 2, 1] = q[:, 1], -q[:, 0]
    rows[:, :, 3:] = np.eye(3)
    solution = np.linalg.lstsq(rows.reshape(-1, 6), f.reshape(-1), rcond=1e-6)[0]
    solution[:3] /= scale
    return np.asarray(solution)


def _without_pitch(twist: Array) -> Array | None:
    omega, v = twist[:3], twist[3:]
    square = float(omega @ omega)
    if square < 1e-8:
        return None
    return np.concatenate([omega, v - omega * float(omega @ v) / square])


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))
