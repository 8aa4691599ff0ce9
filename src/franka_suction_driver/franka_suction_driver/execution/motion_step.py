"""What a running motion tells the executor at every tick, and what they share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flowbothd_common.motion import (
    JointState,
    JointTrajectory,
    MotionReason,
    MotionResult,
    RobotObservation,
)
from flowbothd_common.types import Array


@dataclass(frozen=True)
class Termination:
    """Why a motion is over.

    Attributes:
        reason: Its code.
        message: For people.
        contact: The tool touches something.
    """

    reason: MotionReason
    message: str = ""
    contact: bool = False


@dataclass(frozen=True)
class Step:
    """One tick of a running motion.

    Attributes:
        trajectory: Replaces the running one from now on, if any.
        termination: Set at the last tick.
    """

    trajectory: JointTrajectory | None = None
    termination: Termination | None = None


@dataclass(frozen=True)
class MotionUpdate:
    """What a tick came to.

    Attributes:
        trajectory: To be sent to the arm now, replacing the running one; or None.
        fraction: Progress of the running motion, 0..1.
        result: Set once, when the motion is over.
        shown: What would have been sent, were this not a dry run.
    """

    trajectory: JointTrajectory | None = None
    fraction: float = 0.0
    result: MotionResult | None = None
    shown: JointTrajectory | None = None


class RunningMotion(Protocol):
    """A motion between its start and its termination."""

    @property
    def fraction(self) -> float:
        """Part of the commanded path that has been covered, 0..1."""
        ...

    def tick(self, now: float, commanded: JointState, seen: RobotObservation) -> Step:
        """Advance to `now` [s, node clock]."""
        ...

    def stop(self, now: float, commanded: JointState, termination: Termination) -> Step:
        """Come to rest within the limits and then end as told."""
        ...


class ForceFilter:
    """First-order low pass over the measured force; None until something was measured."""

    def __init__(self, time_constant: float = 0.02) -> None:
        self._time_constant = time_constant
        self._time: float | None = None
        self._force = np.zeros(3)

    def update(self, now: float, wrench: Array | None) -> Array:
        """Return the (3,) filtered force [N] after a measurement; zero while there is none.

        A measurement that is not finite is passed on, so that every limit fails, but never enters
        the filter, which would stay NaN for the rest of the motion.
        """
        if wrench is None:
            return self._force
        if not np.isfinite(wrench[:3]).all():
            return np.full(3, np.nan)
        if self._time is None:
            self._force = np.array(wrench[:3])
        else:
            weight = 1.0 - np.exp(-max(0.0, now - self._time) / self._time_constant)
            self._force = self._force + weight * (wrench[:3] - self._force)
        self._time = now
        return self._force
