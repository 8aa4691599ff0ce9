"""The limits between the points of a trajectory, where a controller interpolates by quintics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flowbothd_common.motion import JointState, JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.arm.limits import JointLimits, Violation

_PARTS = np.linspace(0.0, 1.0, 5)
"""Places of an interval between two points that are checked [-], ends included: in between,
positions and velocities change by less than a thousandth."""


@dataclass(frozen=True)
class TrajectorySamples:
    """A trajectory as a controller commands it, sampled between its points.

    Attributes:
        times: (F,) from the start of the trajectory [s].
        positions: (F, J) [rad].
        velocities: (F, J) [rad/s].
        accelerations: (F, J) [rad/s^2].
        jerks: (F, J) [rad/s^3].
    """

    times: Array
    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array


@dataclass(frozen=True)
class _Quintics:
    """The polynomials between the points, over u = 0..1 of each interval; all (K, J) but `h`."""

    h: Array
    p0: Array
    v0: Array
    a0: Array
    c3: Array
    c4: Array
    c5: Array

    @staticmethod
    def of(trajectory: JointTrajectory, start: JointState) -> _Quintics:
        h = np.diff(trajectory.times, prepend=0.0)[:, None]
        p = np.vstack([start.position, trajectory.positions])
        v = np.vstack([start.velocity, trajectory.velocities])
        a = np.vstack([start.acceleration, trajectory.accelerations])
        p0, v0, a0 = p[:-1], v[:-1] * h, a[:-1] * h * h
        v1, a1 = v[1:] * h, a[1:] * h * h
        way = p[1:] - p0
        c3 = 10 * way - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1
        c4 = -15 * way + 8 * v0 + 7 * v1 + 1.5 * a0 - a1
        c5 = 6 * way - 3 * v0 - 3 * v1 - 0.5 * a0 + 0.5 * a1
        return _Quintics(h, p0, v0, a0, c3, c4, c5)

    def position(self, u: Array) -> Array:
        inner = self.a0 / 2 + u * (self.c3 + u * (self.c4 + u * self.c5))
        return np.asarray(self.p0 + u * (self.v0 + u * inner))

    def velocity(self, u: Array) -> Array:
        inner = 3 * self.c3 + u * (4 * self.c4 + u * 5 * self.c5)
        return np.asarray((self.v0 + u * (self.a0 + u * inner)) / self.h)

    def acceleration(self, u: Array) -> Array:
        inner = 6 * self.c3 + u * (12 * self.c4 + u * 20 * self.c5)
        return np.asarray((self.a0 + u * inner) / self.h**2)

    def jerk(self, u: Array) -> Array:
        return np.asarray((6 * self.c3 + u * (24 * self.c4 + u * 60 * self.c5)) / self.h**3)

    def steepest(self) -> Array:
        """(4, K, J) where acceleration is extreme: both ends, and where the jerk vanishes."""
        a, b, c = 60 * self.c5, 24 * self.c4, 6 * self.c3
        q = -0.5 * (b + np.copysign(np.sqrt(np.maximum(b * b - 4 * a * c, 0.0)), b))
        with np.errstate(divide="ignore", invalid="ignore"):
            return _inside(q / a, c / q)

    def jerkiest(self) -> Array:
        """(3, K, J) where the jerk is extreme: both ends, and between."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return _inside(-0.2 * self.c4 / self.c5)


def _inside(*places: Array) -> Array:
    """Both ends of the interval, and what of `places` lies in it; what does not is put there."""
    ends = np.zeros_like(places[0]), np.ones_like(places[0])
    return np.asarray(np.clip(np.nan_to_num(np.stack([*ends, *places])), 0.0, 1.0))


def fine_samples(
    trajectory: JointTrajectory, start: JointState, parts: Array = _PARTS
) -> TrajectorySamples:
    """Sample every interval, the first from `start` on, at `parts` (P,) of it, 0..1."""
    between = _Quintics.of(trajectory, start)
    u = parts[:, None, None]

    def rolled(values: Array) -> Array:
        return np.asarray(values.swapaxes(0, 1).reshape(-1, values.shape[-1]))

    return TrajectorySamples(
        (_begins(trajectory) + between.h * parts).ravel(),
        rolled(between.position(u)),
        rolled(between.velocity(u)),
        rolled(between.acceleration(u)),
        rolled(between.jerk(u)),
    )


def _begins(trajectory: JointTrajectory) -> Array:
    return np.concatenate([[0.0], trajectory.times[:-1]])[:, None]


def fine_violation(
    limits: JointLimits, trajectory: JointTrajectory, start: JointState, tolerance: float = 1e-6
) -> Violation | None:
    """The worst excess over a limit at or between the points, or None.

    Accelerations and jerks are judged at their extremes. Positions and velocities are judged at
    five places of every interval: between those they change by less than a thousandth.

    Args:
        limits: Of the joints.
        trajectory: In their order.
        start: State that it is entered from.
        tolerance: Accepted excess, as a part of the limit; negative keeps a reserve.
    """
    between = _Quintics.of(trajectory, start)
    centre, half = (limits.upper + limits.lower) / 2, (limits.upper - limits.lower) / 2
    even, steep, jerky = _PARTS[:, None, None], between.steepest(), between.jerkiest()
    worst: Violation | None = None
    worst_ratio = 1.0 + tolerance
    for name, u, values, limit, unit in (
        ("position", even, between.position(even) - centre, half, "rad"),
        ("velocity", even, between.velocity(even), limits.velocity, "rad/s"),
        ("acceleration", steep, between.acceleration(steep), limits.acceleration, "rad/s^2"),
        ("jerk", jerky, between.jerk(jerky), limits.jerk, "rad/s^3"),
    ):
        ratio = np.abs(values) / limit
        if ratio.max() > worst_ratio:
            worst_ratio = float(ratio.max())
            i, k, j = np.unravel_index(int(ratio.argmax()), ratio.shape)
            part = float(np.broadcast_to(u, ratio.shape)[i, k, j])
            time = float(_begins(trajectory)[k, 0] + between.h[k, 0] * part)
            text = (
                f"{name} of {trajectory.joint_names[j]} at {time:.3f} s: "
                f"{abs(float(values[i, k, j])):.4g} of {limit[j]:.4g} {unit}"
            )
            worst = Violation(time, worst_ratio, text, name)
    return worst
