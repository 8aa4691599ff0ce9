"""Probe: from the standoff towards the contact in increments, until the cup holds or touches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flowbothd_common.motion import JointState, MotionReason, RobotObservation
from franka_suction_driver.execution.cartesian_planner import CartesianPlanner, TimedTrajectory
from franka_suction_driver.execution.motion_step import ForceFilter, Step, Termination
from franka_suction_driver.execution.tool_reference import Bounds, Reference
from franka_suction_driver.params import ProbeParams

_SLOWINGS = (1.0, 0.7, 0.4, 0.2, 0.1)
"""Parts of the planned speed to try for an increment, fastest first [-]."""


class Probe:
    """Moves the tool forward until something happens.

    Args:
        planner: Turns tool references into joint trajectories.
        reference: At rest at the start, planned over the reachable part of the way.
        planned: The plan's outcome.
        distance: Length that was asked for [m].
        params: Speeds and forces.
        began: Node clock [s].
    """

    def __init__(
        self,
        planner: CartesianPlanner,
        reference: Reference,
        planned: TimedTrajectory,
        distance: float,
        params: ProbeParams,
        began: float,
    ) -> None:
        self._planner = planner
        self._reference = reference
        self._planned = planned
        self._distance = distance
        self._reachable = min(planned.travel, distance)
        self._params = params
        self._began = began
        self._force = ForceFilter()
        self._goal = 0.0
        self._since_contact: float | None = None
        self._felt = self._blind = False
        self._termination: Termination | None = None
        self._fraction = 0.0

    @property
    def fraction(self) -> float:
        """Part of the longest way that has been covered, 0..1."""
        return self._fraction

    def tick(self, now: float, commanded: JointState, seen: RobotObservation) -> Step:
        """Watch for contact and vacuum; go on by one increment when the last is done."""
        clock = now - self._began
        travel = float(self._reference.travel(clock).position[0])
        self._fraction = min(1.0, travel / self._distance)
        force = self._force.update(now, seen.wrench)
        resting = clock >= self._reference.end
        if self._termination is not None:
            return Step(termination=self._termination) if resting else Step()
        if seen.vacuum:
            return self._halt(clock, commanded, Termination(MotionReason.VACUUM, "", True))
        size = float(np.linalg.norm(force))
        if not size <= self._params.force_limit:
            message = f"{size:.0f} N while probing (limit {self._params.force_limit:.0f} N)"
            return self._halt(
                clock, commanded, Termination(MotionReason.FORCE_LIMIT, message, True)
            )
        if self._since_contact is not None:
            return self._wait_for_vacuum(clock, resting)
        if self._pauses(seen):
            return self._pause(clock, commanded)
        against = -float(force @ self._reference.line.direction)
        if not against <= self._params.contact_force:
            self._since_contact = clock
            return self._braking(clock, commanded)
        return self._advance(clock, commanded) if resting and not self._blind else Step()

    def _pauses(self, seen: RobotObservation) -> bool:
        """Note whether the force is known; return whether it has just been lost."""
        before, self._blind = self._blind, self._felt and seen.wrench is None
        self._felt = self._felt or seen.wrench is not None
        return self._blind and not before

    def _pause(self, clock: float, commanded: JointState) -> Step:
        """Brake until the force is known again: at full speed each blind moment costs newtons."""
        step = self._braking(clock, commanded)
        self._goal = float(self._reference.travel(self._reference.end).position[0])
        return step

    def stop(self, now: float, commanded: JointState, termination: Termination) -> Step:
        """Brake along the direction, then end as told."""
        return self._halt(now - self._began, commanded, termination)

    def _advance(self, clock: float, commanded: JointState) -> Step:
        if self._goal >= self._reachable - 1e-9:
            return Step(termination=self._nothing_found())
        params = self._params
        if self._goal < params.free_distance and self._goal == 0.0:
            step, speed = min(params.free_distance, self._distance), params.free_speed
        else:
            step, speed = params.increment, params.speed
        self._goal = min(self._goal + step, self._reachable)
        return self._issue(clock, commanded, Bounds(speed).scaled(self._planned.slowing))

    def _nothing_found(self) -> Termination:
        if self._planned.problem:
            reason = MotionReason(self._planned.problem)
            message = (
                f"the arm reaches only {self._reachable * 100:.0f} of "
                f"{self._distance * 100:.0f} cm: {self._planned.detail}"
            )
            return Termination(reason, message)
        message = (
            f"no contact within {self._distance * 100:.0f} cm; the surface lies further away than "
            "the cloud says, or the cup passed its edge"
        )
        return Termination(MotionReason.NO_CONTACT, message)

    def _wait_for_vacuum(self, clock: float, resting: bool) -> Step:
        since = self._since_contact or 0.0
        if not resting or clock < since + self._params.vacuum_wait:
            return Step()
        message = (
            f"contact, but no vacuum within {self._params.vacuum_wait:.1f} s; the cup sits on an "
            "edge or an uneven place, or the pump is off"
        )
        return Step(termination=Termination(MotionReason.CONTACT, message, True))

    def _halt(self, clock: float, commanded: JointState, termination: Termination) -> Step:
        self._termination = termination
        if clock >= self._reference.end:
            return Step(termination=termination)
        return self._braking(clock, commanded)

    def _braking(self, clock: float, commanded: JointState) -> Step:
        self._reference, trajectory = self._planner.brake(
            self._reference, clock, commanded, self._planned.path
        )
        return Step(trajectory)

    def _issue(self, clock: float, commanded: JointState, bounds: Bounds) -> Step:
        """The next increment, as fast as the joint limits allow; or the end, if not at all."""
        detail = self._planned.detail
        if self._planned.path is not None:
            for slowing in _SLOWINGS:
                candidate = replace(self._reference)
                candidate.redirect(clock, self._goal, bounds.scaled(slowing))
                timed = self._planner.retimed(self._planned.path, candidate, clock, commanded)
                if timed.good:
                    self._reference = candidate
                    return Step(timed.trajectory)
                detail = timed.detail
        message = f"the arm cannot go on along the probe: {detail}"
        return Step(termination=Termination(MotionReason.SINGULARITY, message))
