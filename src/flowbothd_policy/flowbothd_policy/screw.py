"""The rigid motion without pitch that explains a flow field around one point."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.types import Array, Cloud, JointEstimate, JointKind

_MOVING = 0.1
"""Flow norm above which a point moves [-]; flows are max-normalised."""
_NEIGHBOURS = 40
"""Points of a neighbourhood that a first motion is fitted to."""
_STARTS = 10
"""Neighbourhoods that are tried, spread over all distances."""
_ROUNDS = 6
"""Refits at most until the inliers no longer change."""
_MIN_INLIERS = 12
"""Points at least that must move together: a twist has six numbers."""


@dataclass(frozen=True)
class Screw:
    """Motion of a prismatic or revolute joint fitted to max-normalised flow.

    Attributes:
        joint: The motion; a revolute axis turns the part the way the flow points.
        rate: Flow norm per unit of motion: at 1 m from a revolute axis, or anywhere if prismatic.
        residual: Root mean square over the inliers of the norm of what is not explained.
        inliers: Points that move with it.
    """

    joint: JointEstimate
    rate: float
    residual: float
    inliers: int

    def flow_at(self, point: Array) -> Array:
        """(3,) or (N, 3) flow that the motion gives at points in base, max-normalised."""
        if self.joint.kind is JointKind.PRISMATIC:
            return np.broadcast_to(self.rate * self.joint.axis, np.shape(point)).copy()
        return np.asarray(self.rate * np.cross(self.joint.axis, point - self.joint.point))

    def turned(self, rotation: Array, about: Array) -> Screw:
        """The motion turned by `rotation` (3, 3) about a point (3,): its flow there turns too."""
        point = about + rotation @ (self.joint.point - about)
        joint = replace(self.joint, axis=rotation @ self.joint.axis, point=point)
        return replace(self, joint=joint)

    def radius_at(self, point: Array) -> float:
        """Return the distance of a point from a revolute axis [m]; infinite if prismatic."""
        if self.joint.kind is JointKind.PRISMATIC:
            return float("inf")
        return float(np.linalg.norm(np.cross(self.joint.axis, point - self.joint.point)))


def fit_screw(points: Cloud, flow: NDArray[np.float32], near: Array) -> Screw | None:
    """Fit the motion of the part around `near`, leaving out other parts and outliers.

    Motions are fitted to several neighbourhoods and each takes in whatever moves with it; the
    one that explains most points, `near` among them, wins. So of a cabinet whose other doors move
    too the one door's hinge is found, even where two doors meet.

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
    inliers = _consensus(p, f)
    if inliers is None:
        return None
    p, f = p[inliers], f[inliers]
    line = np.mean(f, axis=0)
    line_error = _rms(f - line)
    turning = _without_pitch(_twist(_rows(p), f))
    # A twist always fits at least as well as a line: it must earn its three further numbers.
    if turning is None or line_error**2 <= 1.1 * _rms(f - _field(turning, p)) ** 2 + 2.5e-3:
        rate = float(np.linalg.norm(line))
        if rate < _MOVING:
            return None
        return Screw(
            JointEstimate(JointKind.PRISMATIC, line / rate, np.zeros(3)), rate, line_error, len(p)
        )
    omega, v = turning[:3], turning[3:]
    rate = float(np.linalg.norm(omega))
    foot = np.cross(omega, v) / rate**2 + near
    error = _rms(f - _field(turning, p))
    return Screw(JointEstimate(JointKind.REVOLUTE, omega / rate, foot), rate, error, len(p))


def _consensus(p: Array, f: Array) -> NDArray[np.bool_] | None:
    """Which points move with those around the origin."""
    rows = _rows(p)
    order = np.argsort(np.linalg.norm(p, axis=1), kind="stable")
    here = order[: min(10, len(order))]
    centres = order[np.linspace(0, len(order) - 1, min(_STARTS, len(order))).astype(int)]
    local = order[:_NEIGHBOURS]
    spread = _residuals(rows, f, _twist(rows[local], f[local]))[local]
    threshold = float(np.clip(3 * np.median(spread), 0.1, 0.3))
    # A neighbourhood may be too small to tell a rotation from noise; as a translation it finds
    # the points that move alike, and their wider base then tells.
    starts = [np.concatenate([np.zeros(3), np.median(f[local], axis=0)])]
    for centre in centres:
        nearest = np.argsort(np.linalg.norm(p - p[centre], axis=1), kind="stable")[:_NEIGHBOURS]
        starts.append(_twist(rows[nearest], f[nearest]))
    best, best_score = None, 0.0
    for start in starts:
        inliers = _grow(rows, f, start, threshold)
        if inliers is None:
            continue
        residual = _residuals(rows, f, _twist(rows[inliers], f[inliers]))
        if float(np.median(residual[here])) > threshold:
            continue
        score = float(np.sum(np.maximum(0.0, 1 - (residual / threshold) ** 2)))
        if score > best_score:
            best, best_score = inliers, score
    return best


def _grow(rows: Array, f: Array, start: Array, threshold: float) -> NDArray[np.bool_] | None:
    inliers = _residuals(rows, f, start) < 2 * threshold
    for _ in range(_ROUNDS):
        if np.count_nonzero(inliers) < _MIN_INLIERS:
            return None
        grown = _residuals(rows, f, _twist(rows[inliers], f[inliers])) < threshold
        if np.array_equal(grown, inliers):
            break
        inliers = grown
    return inliers if np.count_nonzero(inliers) >= _MIN_INLIERS else None


def _rows(p: Array) -> Array:
    """(N, 3, 6) that maps angular and linear rate at the origin to the flow of each point."""
    rows = np.zeros((len(p), 3, 6))
    rows[:, 0, 1], rows[:, 0, 2] = p[:, 2], -p[:, 1]
    rows[:, 1, 0], rows[:, 1, 2] = -p[:, 2], p[:, 0]
    rows[:, 2, 0], rows[:, 2, 1] = p[:, 1], -p[:, 0]
    rows[:, :, 3:] = np.eye(3)
    return rows


def _residuals(rows: Array, f: Array, twist: Array) -> Array:
    return np.asarray(np.linalg.norm(f - rows @ twist, axis=1))


def _field(twist: Array, p: Array) -> Array:
    return np.asarray(twist[3:] + np.cross(twist[:3], p))


def _twist(rows: Array, f: Array) -> Array:
    """(6,) angular and linear rate at the origin, in the least squares sense."""
    flat = rows.reshape(-1, 6)
    # Points of a flat patch leave no direction undetermined, points on one line leave a rotation
    # about it: the tiny ridge then chooses none.
    normal = flat.T @ flat
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    scaled = normal / np.outer(scale, scale) + 1e-9 * np.eye(6)
    return np.asarray(np.linalg.solve(scaled, (flat.T @ f.reshape(-1)) / scale) / scale)


def _without_pitch(twist: Array) -> Array | None:
    omega, v = twist[:3], twist[3:]
    square = float(omega @ omega)
    if square < 1e-8:
        return None
    return np.concatenate([omega, v - omega * float(omega @ v) / square])


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))
