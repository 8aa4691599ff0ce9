"""Goals given to the arm and what it returns: trajectories, observations, results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from flowbothd_common.types import Array, JointEstimate


class MotionKind(StrEnum):
    """The motions that the policy can ask for."""

    APPROACH = "approach"
    PROBE = "probe"
    FLOW_STEP = "flow_step"
    RETREAT = "retreat"


class MotionReason(StrEnum):
    """Why a motion ended; the values of flowbothd_interfaces/MotionResult."""

    REACHED = "reached"
    CONTACT = "contact"
    VACUUM = "vacuum"
    NO_CONTACT = "no_contact"
    FORCE_LIMIT = "force_limit"
    STALLED = "stalled"
    LAGGING = "lagging"
    SUCTION_LOST = "suction_lost"
    UNREACHABLE = "unreachable"
    JOINT_LIMIT = "joint_limit"
    SINGULARITY = "singularity"
    COLLISION = "collision"
    STALE_INPUT = "stale_input"
    STOPPED = "stopped"
    REJECTED = "rejected"
    TIMEOUT = "timeout"


@dataclass(frozen=True)
class MotionGoal:
    """One motion, in the base frame.

    Attributes:
        kind: Which motion.
        contact: (3,) where to touch [m]; approach only.
        direction: (3,) unit vector. Approach: the flow at the contact, the tool comes from that
            side. Probe: direction of travel. Flow step: the flow to follow. Retreat: unused.
        distance: How far [m]; 0 = the default of the motion's parameters.
        joint: How the part is expected to move, if anything is known.
    """

    kind: MotionKind
    contact: Array | None = None
    direction: Array | None = None
    distance: float = 0.0
    joint: JointEstimate | None = None


@dataclass(frozen=True)
class JointState:
    """Motion of all joints at one instant.

    Attributes:
        position: (J,) [rad].
        velocity: (J,) [rad/s].
        acceleration: (J,) [rad/s^2].
    """

    position: Array
    velocity: Array
    acceleration: Array

    @staticmethod
    def at_rest(position: Array) -> JointState:
        """Return the state of rest at (J,) [rad]."""
        zero = np.zeros(len(position))
        return JointState(np.array(position, dtype=float), zero, zero)


@dataclass(frozen=True)
class JointTrajectory:
    """Joint positions, velocities and accelerations over time, ending at rest.

    Attributes:
        joint_names: J names.
        times: (T,) seconds from the start of the trajectory, strictly increasing, first > 0.
        positions: (T, J) [rad].
        velocities: (T, J) [rad/s], last row zero.
        accelerations: (T, J) [rad/s^2], last row zero.
    """

    joint_names: tuple[str, ...]
    times: Array
    positions: Array
    velocities: Array
    accelerations: Array


@dataclass(frozen=True)
class RobotObservation:
    """Measurements of the robot at one instant.

    Attributes:
        time: Node clock [s].
        positions: (J,) [rad], in the order of the motion parameters' joint names.
        velocities: (J,) [rad/s].
        wrench: (6,) force [N] and torque [Nm] that the environment exerts on the tool, at the
            suction tip, in base axes; None while nothing has been measured.
        vacuum: The cup holds a part.
        vacuum_lost: A part was held in this suction cycle and has come off.
    """

    time: float
    positions: Array
    velocities: Array
    wrench: Array | None = None
    vacuum: bool = False
    vacuum_lost: bool = False

    def problem(self) -> str:
        """Return which values are not finite, in words; empty if all are."""
        parts: dict[str, Array | float] = {
            "time": self.time,
            "joint positions": self.positions,
            "joint velocities": self.velocities,
            "wrench": 0.0 if self.wrench is None else self.wrench,
        }
        bad = [name for name, values in parts.items() if not np.isfinite(values).all()]
        return f"{', '.join(bad)} not finite" if bad else ""


@dataclass(frozen=True)
class MotionResult:
    """Outcome of one motion.

    Attributes:
        kind: Which motion.
        reason: Why it ended.
        message: For people: what happened and what would help.
        reached_fraction: Of the commanded path, 0..1.
        tool_start: (4, 4) T_base_tip measured when the motion began.
        tool_end: (4, 4) T_base_tip measured when it ended.
        contact: The tool touches something.
        vacuum: The cup holds a part.
        peak_wrench: (6,) largest measured |force| and |torque| with their directions [N, Nm].
        max_lag: Largest joint difference between reference and command [rad].
        duration: [s], node clock.
    """

    kind: MotionKind
    reason: MotionReason
    message: str = ""
    reached_fraction: float = 0.0
    tool_start: Array = field(default_factory=lambda: np.eye(4))
    tool_end: Array = field(default_factory=lambda: np.eye(4))
    contact: bool = False
    vacuum: bool = False
    peak_wrench: Array = field(default_factory=lambda: np.zeros(6))
    max_lag: float = 0.0
    duration: float = 0.0

    @property
    def tool_motion(self) -> Array:
        """(3,) measured displacement of the suction tip in base [m]."""
        return np.asarray(self.tool_end[:3, 3] - self.tool_start[:3, 3])


def joint_order(wanted: Sequence[str], present: Sequence[str]) -> list[int]:
    """Indices that put values given for `present` joints into the order of `wanted`.

    Raises:
        KeyError: a wanted joint is not present; the message lists the missing ones.
    """
    missing = [name for name in wanted if name not in present]
    if missing:
        raise KeyError(f"joints missing: {missing}; present: {list(present)}")
    index = {name: i for i, name in enumerate(present)}
    return [index[name] for name in wanted]
