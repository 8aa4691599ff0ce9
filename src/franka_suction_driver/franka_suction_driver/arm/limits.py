"""Limits of joint motion: from the robot description and parameters, and the check against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flowbothd_common.errors import ParameterError
from flowbothd_common.motion import JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.params import RobotParams


@dataclass(frozen=True)
class PositionBox:
    """Joint position limits with a margin already taken off.

    Attributes:
        lower: (J,) [rad].
        upper: (J,) [rad].
    """

    lower: Array
    upper: Array

    def clip(self, q: Array) -> Array:
        """(..., J) nearest configuration inside."""
        return np.clip(q, self.lower, self.upper)

    def contains(self, q: Array, tolerance: float = 1e-9) -> Array:
        """(...,) whether every joint is inside."""
        inside = (q >= self.lower - tolerance) & (q <= self.upper + tolerance)
        return np.asarray(inside.all(axis=-1))

    def margin(self, q: Array) -> Array:
        """(...,) smallest distance to a limit [rad]; negative outside."""
        return np.asarray(np.minimum(q - self.lower, self.upper - q).min(axis=-1))

    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """(count, J) uniform configurations."""
        return np.asarray(rng.uniform(self.lower, self.upper, (count, len(self.lower))))


@dataclass(frozen=True)
class Violation:
    """The worst excess of a trajectory over its limits.

    Attributes:
        time: When, from the start of the trajectory [s].
        ratio: Amount over limit, > 1.
        text: For people.
        what: Of which limit: position, velocity, acceleration or jerk.
    """

    time: float
    ratio: float
    text: str
    what: str

    def __str__(self) -> str:
        """For messages."""
        return self.text


@dataclass(frozen=True)
class JointLimits:
    """What no sample of any trajectory may exceed; all arrays are (J,), in joint order.

    Attributes:
        lower: [rad].
        upper: [rad].
        velocity: [rad/s].
        acceleration: [rad/s^2].
        jerk: [rad/s^3].
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array

    def __post_init__(self) -> None:
        """Reject limits that leave no motion."""
        for name in ("velocity", "acceleration", "jerk"):
            values = getattr(self, name)
            if values.shape != self.lower.shape or not (values > 0).all():
                raise ParameterError(
                    f"joint {name} limits",
                    got=np.asarray(values).tolist(),
                    allowed=f"{len(self.lower)} values > 0",
                )
        if not (self.lower < self.upper).all():
            raise ParameterError(
                "joint position limits are crossed",
                got=np.column_stack([self.lower, self.upper]).tolist(),
            )

    def scaled(self, factor: float) -> JointLimits:
        """Velocity, acceleration and jerk limits times `factor`, 0 < factor <= 1."""
        if not 0 < factor <= 1:
            raise ParameterError("speed scale", got=factor, allowed="0 < scale <= 1")
        return JointLimits(
            self.lower,
            self.upper,
            self.velocity * factor,
            self.acceleration * factor,
            self.jerk * factor,
        )

    def box(self, margin: float) -> PositionBox:
        """Position limits less `margin` [rad] on both sides."""
        return PositionBox(self.lower + margin, self.upper - margin)

    def violation(self, trajectory: JointTrajectory, tolerance: float = 1e-6) -> Violation | None:
        """The worst sample beyond a limit, or None; jerk is judged between samples."""
        joints = trajectory.joint_names
        jerk = np.diff(trajectory.accelerations, axis=0) / np.diff(trajectory.times)[:, None]
        centre, half = (self.upper + self.lower) / 2, (self.upper - self.lower) / 2
        checks = [
            ("position", trajectory.positions - centre, half, "rad"),
            ("velocity", trajectory.velocities, self.velocity, "rad/s"),
            ("acceleration", trajectory.accelerations, self.acceleration, "rad/s^2"),
            ("jerk", jerk, self.jerk, "rad/s^3"),
        ]
        worst: Violation | None = None
        worst_ratio = 1.0 + tolerance
        for name, values, limit, unit in checks:
            ratio = np.abs(values) / limit
            if ratio.size and not ratio.max() <= worst_ratio:
                worst_ratio = float(ratio.max())
                k, j = np.unravel_index(int(ratio.argmax()), ratio.shape)
                amount, allowed = abs(float(values[k, j])), f"at most {limit[j]:.4g}"
                if name == "position":
                    amount = float(trajectory.positions[k, j])
                    allowed = f"{self.lower[j]:.4g} .. {self.upper[j]:.4g}"
                text = (
                    f"{name} of {joints[j]} at {trajectory.times[k]:.3f} s: "
                    f"{amount:.4g} {unit}, allowed {allowed} {unit}"
                )
                worst = Violation(float(trajectory.times[k]), worst_ratio, text, name)
        return worst


def limits_from(
    kinematics: Kinematics,
    acceleration: Sequence[float],
    jerk: Sequence[float],
    *,
    velocity: Sequence[float] = (),
    lower: Sequence[float] = (),
    upper: Sequence[float] = (),
) -> JointLimits:
    """Limits with positions and velocities of the robot description and the rest as given.

    Args:
        kinematics: The arm.
        acceleration: J values [rad/s^2]; a URDF has no place for them.
        jerk: J values [rad/s^3].
        velocity: J values [rad/s] instead of the description's, or empty.
        lower: J values [rad] instead of the description's, or empty.
        upper: J values [rad] instead of the description's, or empty.

    Raises:
        ParameterError: not one positive value per joint.
    """
    model = kinematics.model

    def per_joint(name: str, values: Sequence[float], default: Array | None = None) -> Array:
        if default is not None and not len(values):
            return np.array(default)
        if len(values) != kinematics.dof:
            raise ParameterError(
                f"joint {name} limits", got=list(values), allowed=f"{kinematics.dof} values"
            )
        return np.array(values, dtype=float)

    return JointLimits(
        lower=per_joint("lower position", lower, model.lowerPositionLimit),
        upper=per_joint("upper position", upper, model.upperPositionLimit),
        velocity=per_joint("velocity", velocity, model.upperVelocityLimit),
        acceleration=per_joint("acceleration", acceleration),
        jerk=per_joint("jerk", jerk),
    )


def robot_limits(kinematics: Kinematics, params: RobotParams) -> JointLimits:
    """The limits that the parameters name; what they leave open comes from the description.

    Raises:
        ParameterError: not one positive value per joint.
    """
    return limits_from(
        kinematics,
        params.acceleration_limits,
        params.jerk_limits,
        velocity=params.velocity_limits,
        lower=params.lower_limits,
        upper=params.upper_limits,
    )
