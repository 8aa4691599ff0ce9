"""The limits between the points of a trajectory, where a controller interpolates by quintics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flowbothd_common.motion import JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.limits import JointLimits, Violation
from franka_suction_driver.trajectory import JointState

_PARTS = np.linspace(0.0, 1.0, 5)


@dataclass(frozen=True)
class FineSamples:
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


def fine_samples(
    trajectory: JointTrajectory, start: JointState, parts: Array = _PARTS
) -> FineSamples:
    """Sample every interval, the first from `start` on, at `parts` (P,) of it, 0..1."""
    times = np.concatenate([[0.0], trajectory.times])
    rows = (
        np.vstack([start.position, trajectory.positions]),
        np.vstack([start.velocity, trajectory.velocities]),
        np.vstack([start.acceleration, trajectory.accelerations]),
    )
    h = np.diff(times)[:, None]
    p0, v0, a0 = rows[0][:-1], rows[1][:-1] * h, rows[2][:-1] * h * h
    p1, v1, a1 = rows[0][1:], rows[1][1:] * h, rows[2][1:] * h * h
    way = p1 - p0
    c3 = 10 * way - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15 * way + 8 * v0 + 7 * v1 + 1.5 * a0 - a1
    c5 = 6 * way - 3 * v0 - 3 * v1 - 0.5 * a0 + 0.5 * a1
    u = parts[:, None, None]
    position = p0 + u * (v0 + u * (a0 / 2 + u * (c3 + u * (c4 + u * c5))))
    velocity = (v0 + u * (a0 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))) / h
    acceleration = (a0 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5))) / h**2
    jerk = (6 * c3 + u * (24 * c4 + u * 60 * c5)) / h**3

    def rolled(values: Array) -> Array:
        return np.asarray(values.swapaxes(0, 1).reshape(-1, values.shape[-1]))

    fine_times = (times[:-1, None] + h * parts).ravel()
    return FineSamples(
        fine_times, rolled(position), rolled(velocity), rolled(acceleration), rolled(jerk)
    )


def fine_violation(
    limits: JointLimits, trajectory: JointTrajectory, start: JointState, tolerance: float = 1e-6
) -> Violation | None:
    """The worst excess over a limit at or between the points, or None.

    Args:
        limits: Of the joints.
        trajectory: In their order.
        start: State that it is entered from.
        tolerance: Accepted excess, as a part of the limit; negative keeps a reserve.
    """
    fine = fine_samples(trajectory, start)
    centre, half = (limits.upper + limits.lower) / 2, (limits.upper - limits.lower) / 2
    worst: Violation | None = None
    worst_ratio = 1.0 + tolerance
    for name, values, limit, unit in (
        ("position", fine.positions - centre, half, "rad"),
        ("velocity", fine.velocities, limits.velocity, "rad/s"),
        ("acceleration", fine.accelerations, limits.acceleration, "rad/s^2"),
        ("jerk", fine.jerks, limits.jerk, "rad/s^3"),
    ):
        ratio = np.abs(values) / limit
        if ratio.max() > worst_ratio:
            worst_ratio = float(ratio.max())
            k, j = np.unravel_index(int(ratio.argmax()), ratio.shape)
            text = (
                f"{name} of {trajectory.joint_names[j]} at {fine.times[k]:.3f} s: "
                f"{abs(float(values[k, j])):.4g} of {limit[j]:.4g} {unit}"
            )
            worst = Violation(float(fine.times[k]), worst_ratio, text)
    return worst
