"""A free joint motion along a planned trajectory: Approach and Retreat."""

from __future__ import annotations

import numpy as np

from flowbothd_common.motion import JointState, JointTrajectory, MotionReason, RobotObservation
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.arm.trajectory import joint_stop
from franka_suction_driver.execution.motion_step import ForceFilter, Step, Termination

_SETTLED = 0.01
"""Joint error at which a motion has arrived [rad]."""
_SETTLE_TIME = 1.0
"""Longest wait for the arm to arrive after the trajectory has ended [s]."""
_RELEASE_TIME = 3.0
"""Longest wait for the cup to vent before a retreat [s]: pumps take a moment to vent."""


class JointMotion:
    """Issues one trajectory and watches it.

    Args:
        trajectory: From rest to rest.
        limits: For stopping.
        force_limit: Contact force that stops the motion [N].
        force_grace: Time in which it may still lean on what it leaves [s].
        note: Message of the result if all goes well.
        released: Wait until the cup holds nothing before moving.
    """

    def __init__(
        self,
        trajectory: JointTrajectory,
        limits: JointLimits,
        force_limit: float,
        *,
        force_grace: float = 0.0,
        note: str = "",
        released: bool = False,
    ) -> None:
        self._trajectory = trajectory
        self._limits = limits
        self._force_limit = force_limit
        self._grace = force_grace
        self._note = note
        self._released = released
        self._force = ForceFilter()
        self._asked: float | None = None
        self._began: float | None = None
        self._ends = 0.0
        self._termination: Termination | None = None
        self._fraction = 0.0

    @property
    def fraction(self) -> float:
        """Part of the trajectory's time that has passed, 0..1."""
        return self._fraction

    def tick(self, now: float, commanded: JointState, seen: RobotObservation) -> Step:
        """Begin, watch the force, and end when the arm has arrived."""
        if self._asked is None:
            self._asked = now
        if self._began is None and self._termination is None:
            return self._begin(now, seen)
        force = self._force.update(now, seen.wrench)
        size = float(np.linalg.norm(force))
        if self._termination is None and self._began is not None:
            self._fraction = min(1.0, (now - self._began) / float(self._trajectory.times[-1]))
            if not size <= self._force_limit and now > self._began + self._grace:
                message = (
                    f"unexpected contact of {size:.0f} N (limit {self._force_limit:.0f} N) on a "
                    "free motion; retreat, and check that the object cloud shows what is in the way"
                )
                return self.stop(
                    now, commanded, Termination(MotionReason.FORCE_LIMIT, message, True)
                )
        if now < self._ends:
            return Step()
        if self._termination is not None:
            return Step(termination=self._termination)
        lag = float(np.abs(seen.positions - commanded.position).max())
        if lag < _SETTLED:
            return Step(termination=Termination(MotionReason.REACHED, self._note))
        if now < self._ends + _SETTLE_TIME:
            return Step()
        message = f"the arm stays {lag:.3f} rad behind the trajectory; is the controller running?"
        return Step(termination=Termination(MotionReason.LAGGING, message))

    def stop(self, now: float, commanded: JointState, termination: Termination) -> Step:
        """Brake all joints within their limits, then end as told."""
        self._termination = termination
        if self._began is None:
            return Step(termination=termination)
        trajectory = joint_stop(self._trajectory.joint_names, commanded, self._limits)
        self._ends = now + float(trajectory.times[-1])
        return Step(trajectory)

    def _begin(self, now: float, seen: RobotObservation) -> Step:
        if self._released and seen.vacuum:
            if self._asked is not None and now - self._asked > _RELEASE_TIME:
                message = "the cup still holds the part; switch the suction off before retreating"
                return Step(termination=Termination(MotionReason.REJECTED, message))
            return Step()
        self._began = now
        self._ends = now + float(self._trajectory.times[-1])
        return Step(self._trajectory)
