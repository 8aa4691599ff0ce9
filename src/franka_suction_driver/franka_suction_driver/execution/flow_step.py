"""FlowStep: one guarded step of a held part along its flow, soft across it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flowbothd_common.motion import JointState, MotionReason, RobotObservation
from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.execution.cartesian_planner import CartesianPlanner, TimedTrajectory
from franka_suction_driver.execution.motion_step import ForceFilter, Step, Termination
from franka_suction_driver.execution.tool_reference import Reference
from franka_suction_driver.params import FlowStepParams

_REPLACE_PERIOD = 0.05
"""Shortest time between two replacements of the trajectory [s]: each costs a few milliseconds of
inverse kinematics."""
_SMALLEST_SHIFT = 5e-5
"""Offset below which the trajectory is not replaced [m]: less than the arm's repeatability."""
_LARGEST_LEAD = 0.003
"""Lead of the wanted offset over the present one [m]: the reference must not run on when the force
drops."""
_RELAX_TIME = 1.0
"""Longest time in which force is let go after a stop [s]."""
_MOST_RELAXING = 0.012
"""Longest way of letting go after a stop [m]: against a door that swings back it would become a
motion by itself."""
_SLOWER = (0.5, 0.2)
"""Parts of the planned speed to try where giving way makes the joints too fast [-]."""


class FlowStep:
    """Moves the held part and gives way to forces across the flow.

    Ends early, after braking within the limits, when the force on the tool, the lag of the
    measured tool, or the loss of the part says so; force that has built up is let go before the
    end, so that nothing is left wound up.

    Args:
        kinematics: For measuring the tool.
        planner: Turns tool references into joint trajectories.
        reference: Planned step, at rest at its start.
        planned: The plan's outcome.
        distance: Length that was asked for [m].
        params: Speeds, forces, admittance.
        began: Node clock [s].
    """

    def __init__(
        self,
        kinematics: Kinematics,
        planner: CartesianPlanner,
        reference: Reference,
        planned: TimedTrajectory,
        distance: float,
        params: FlowStepParams,
        began: float,
    ) -> None:
        self._kinematics = kinematics
        self._planner = planner
        self._reference = reference
        self._planned = planned
        self._distance = distance
        self._params = params
        self._began = began
        self._force = ForceFilter()
        self._offset: Array = np.zeros(3)
        self._braked_at: Array = np.zeros(3)
        self._replaced: float | None = None
        self._moved_on = 0.0
        self._termination: Termination | None = None
        self._relax_until: float | None = None
        self._fraction = 0.0

    @property
    def fraction(self) -> float:
        """Part of the step that has been covered, 0..1."""
        return self._fraction

    def tick(self, now: float, commanded: JointState, seen: RobotObservation) -> Step:
        """Give way across the flow, and check the guards."""
        force = self._force.update(now, seen.wrench)
        if self._replaced is None:
            # The clock starts when the trajectory goes out, not when it was planned.
            self._began = now
            self._replaced = self._moved_on = 0.0
            return Step(self._planned.trajectory)
        clock = now - self._began
        travel = float(self._reference.travel(clock).position[0])
        if self._termination is None:
            self._fraction = min(1.0, travel / self._distance)
            termination = self._guard(travel, force, seen)
            if termination is not None:
                return self._brake(clock, commanded, termination)
        return self._settle(clock, commanded, force)

    def stop(self, now: float, commanded: JointState, termination: Termination) -> Step:
        """Brake along the flow, then end as told."""
        return self._brake(now - self._began, commanded, termination)

    def _guard(self, travel: float, force: Array, seen: RobotObservation) -> Termination | None:
        params = self._params
        if seen.vacuum_lost or not seen.vacuum:
            message = (
                f"the part came off after {travel * 100:.1f} cm; step more slowly, or grasp where "
                "the surface is flat"
            )
            return Termination(MotionReason.SUCTION_LOST, message)
        size = float(np.linalg.norm(force))
        if not size <= params.force_limit:
            message = (
                f"{size:.0f} N after {travel * 100:.1f} cm (limit {params.force_limit:.0f} N): "
                "the part is blocked, at its end stop, or moves another way"
            )
            return Termination(MotionReason.FORCE_LIMIT, message, True)
        line = self._reference.line
        tip = self._kinematics.tip(seen.positions).position
        lag = travel - float((tip - line.origin) @ line.direction)
        if not lag <= params.stall_distance and size < params.relaxed_force:
            message = (
                f"the tool is {lag * 1000:.0f} mm behind after {travel * 100:.1f} cm, and nothing "
                f"holds it ({size:.1f} N): the arm does not follow its command"
            )
            return Termination(MotionReason.LAGGING, message)
        if not lag <= params.stall_distance:
            message = (
                f"the tool is {lag * 1000:.0f} mm behind after {travel * 100:.1f} cm: it no longer "
                "moves, the part is blocked or moves another way"
            )
            return Termination(MotionReason.STALLED, message, True)
        return None

    def _settle(self, clock: float, commanded: JointState, force: Array) -> Step:
        """Give way; end once the reference rests and the force has relaxed, or time is up."""
        relaxing = self._termination is not None and self._relax_until is not None
        if self._termination is not None and not relaxing:
            return Step(termination=self._termination) if clock >= self._reference.end else Step()
        direction = self._reference.line.direction
        yielding = force if relaxing else force - direction * float(force @ direction)
        along = self._reference.along_since + self._reference.along.duration
        if clock >= along:
            limit = self._relax_until if self._relax_until is not None else along
            patience = 0.0 if relaxing else self._params.settle_time
            relaxed = float(np.linalg.norm(yielding)) < self._params.relaxed_force
            if relaxed or clock >= limit + patience:
                self._relax_until = None
                self._termination = self._termination or self._completed()
                if clock >= self._reference.end:
                    return Step(termination=self._termination)
                return Step()
        return self._give_way(clock, commanded, yielding)

    def _give_way(self, clock: float, commanded: JointState, force: Array) -> Step:
        elapsed = clock - self._moved_on
        self._moved_on = clock
        now_at = self._reference.offset_state(clock).position
        ahead = self._offset + force * self._params.admittance * elapsed - now_at
        # What is asked for stays close to what is: it must not run on when the force is gone.
        wanted = now_at + _shortened(ahead, _LARGEST_LEAD)
        if self._relax_until is None:
            self._offset = _shortened(wanted, self._params.max_offset)
        else:
            # Letting go is not to become a motion of its own, against a door that swings back.
            self._offset = self._braked_at + _shortened(wanted - self._braked_at, _MOST_RELAXING)
        due = self._replaced is None or clock - self._replaced >= _REPLACE_PERIOD - 1e-6
        goal = self._reference.offset.at(self._reference.offset.duration).position
        if not due or np.linalg.norm(self._offset - goal) < _SMALLEST_SHIFT:
            return Step()
        candidate = replace(self._reference)
        candidate.shift(clock, self._offset)
        timed = self._planner.follow(candidate, clock, commanded)
        for part in _SLOWER:
            if not timed.too_fast:
                break
            # What lies ahead is too fast off the planned line; giving way now matters more.
            candidate = replace(candidate)
            candidate.slow_down(clock, part * self._planned.slowing * self._params.speed)
            timed = self._planner.follow(candidate, clock, commanded)
        if not timed.good:
            # The arm cannot give way further: the force guard decides what becomes of it.
            return Step()
        self._reference = candidate
        self._replaced = clock
        return Step(timed.trajectory)

    def _brake(self, clock: float, commanded: JointState, termination: Termination) -> Step:
        if self._termination is not None and termination.reason is not MotionReason.STOPPED:
            return Step()
        self._termination = termination
        if termination.reason in (MotionReason.FORCE_LIMIT, MotionReason.STALLED):
            self._relax_until = clock + _RELAX_TIME
        if self._replaced is None:
            return Step(termination=termination)
        self._offset = self._braked_at = self._reference.offset_state(clock).position
        self._reference, trajectory = self._planner.brake(self._reference, clock, commanded)
        self._moved_on = self._replaced = clock
        return Step(trajectory)

    def _completed(self) -> Termination:
        problem = self._planned.problem
        if not problem:
            return Termination(MotionReason.REACHED, "", True)
        reason = MotionReason(problem)
        message = (
            f"the arm reaches only {self._planned.travel * 100:.1f} of "
            f"{self._distance * 100:.1f} cm: {self._planned.detail}"
        )
        return Termination(reason, message, True)


def _shortened(vector: Array, longest: float) -> Array:
    """The vector, or one of its direction with length `longest`."""
    size = float(np.linalg.norm(vector))
    return np.asarray(vector if size <= longest else vector * (longest / size))
