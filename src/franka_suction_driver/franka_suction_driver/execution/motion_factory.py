"""Turns a checked goal and its plan into a running motion, or says why there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace

from flowbothd_common.errors import MotionRejectedError
from flowbothd_common.motion import (
    JointState,
    MotionGoal,
    MotionKind,
    MotionReason,
    RobotObservation,
)
from flowbothd_common.types import Array, JointEstimate
from franka_suction_driver.arm.kinematics import Kinematics, TipState
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.execution.cartesian_planner import CartesianPlanner, TimedTrajectory
from franka_suction_driver.execution.flow_step import FlowStep
from franka_suction_driver.execution.goals import (
    lagging_axis,
    led_axes,
    tool_line,
    travel_direction,
)
from franka_suction_driver.execution.joint_motion import JointMotion
from franka_suction_driver.execution.motion_step import RunningMotion, Termination
from franka_suction_driver.execution.probe import Probe
from franka_suction_driver.execution.tool_reference import Bounds, Reference
from franka_suction_driver.params import MotionParams
from franka_suction_driver.planning.collision import CollisionChecker
from franka_suction_driver.planning.opening_path import displacement
from franka_suction_driver.planning.planner import PlannedMotion

_ENOUGH = 0.9
"""Part of the asked distance that makes a tool axis good enough [-]; otherwise the next is
tried."""
_TOUCH_DISTANCE = 0.005
"""Way that a step stops short of a contact of the arm, and the shortest step [m]."""
_RETREAT_GRACE = 0.5
"""Time in which a retreating arm may still lean on what it leaves [s]."""


@dataclass(frozen=True)
class PlannedGoal:
    """A goal with its plan, ready to begin."""

    goal: MotionGoal
    planned: PlannedMotion | None


class MotionFactory:
    """Creates the four kinds of motion.

    Args:
        robot: The arm.
        limits: Joint limits.
        planner: Turns tool references into joint trajectories.
        bare: Collisions of the arm with itself and the table, without any object.
        params: Parameters of the motion core, speeds scaled.
    """

    def __init__(
        self,
        robot: Kinematics,
        limits: JointLimits,
        planner: CartesianPlanner,
        bare: CollisionChecker,
        params: MotionParams,
    ) -> None:
        self._robot, self._limits, self._planner = robot, limits, planner
        self._bare, self._params = bare, params

    def create(
        self, prepared: PlannedGoal, seen: RobotObservation, start: JointState
    ) -> RunningMotion | Termination:
        """The motion from the commanded state `start`, or why it does not begin.

        Raises:
            MotionRejectedError: the goal makes no sense here.
        """
        goal = prepared.goal
        if goal.kind in (MotionKind.APPROACH, MotionKind.RETREAT):
            return self._joint_motion(goal.kind, prepared.planned)
        if seen.wrench is None:
            message = "no external wrench has been measured; guarded motions need it"
            return Termination(MotionReason.STALE_INPUT, message)
        if goal.direction is None:
            raise MotionRejectedError("the goal has no direction")
        if goal.kind is MotionKind.PROBE:
            return self._probe(goal, goal.direction, seen, start)
        return self._flow_step(goal, goal.direction, seen, start)

    def _joint_motion(
        self, kind: MotionKind, planned: PlannedMotion | None
    ) -> RunningMotion | Termination:
        if planned is None or planned.trajectory is None:
            reason = MotionReason.REJECTED if planned is None else planned.reason
            return Termination(reason, "" if planned is None else planned.message)
        retreating = kind is MotionKind.RETREAT
        return JointMotion(
            planned.trajectory,
            self._limits,
            self._params.approach.force_limit,
            force_grace=_RETREAT_GRACE if retreating else 0.0,
            note=planned.message,
            released=retreating,
        )

    def _probe(
        self, goal: MotionGoal, direction: Array, seen: RobotObservation, start: JointState
    ) -> RunningMotion:
        params = self._params.probe
        distance = goal.distance or params.max_distance
        tip = self._robot.tip(start.position)
        travel = travel_direction(tip.axis, direction)
        line = tool_line(tip, travel, distance, tip.axis, 0.0)
        reference, timed = self._planner.plan(line, Bounds(params.free_speed), start)
        still = replace(reference)
        still.redirect(0.0, 0.0, Bounds(params.speed))
        return Probe(self._planner, still, timed, distance, params, seen.time)

    def _clear_of_table(
        self, reference: Reference, timed: TimedTrajectory, speed: float, start: JointState
    ) -> tuple[Reference, TimedTrajectory]:
        """The step, shortened to where the arm would touch the table or itself."""
        if timed.trajectory is None or not self._bare.free(start.position):
            return reference, timed
        positions = timed.trajectory.positions
        free = self._bare.free_count(positions)
        if free == len(positions):
            return reference, timed
        touch = f"the arm would touch: {self._bare.touch(positions[free])}"
        way = float(reference.travel(float(timed.trajectory.times[free])).position[0])
        length = way - _TOUCH_DISTANCE
        if length < _TOUCH_DISTANCE:
            return reference, TimedTrajectory(None, 0.0, MotionReason.COLLISION.value, touch)
        shorter = replace(reference.line, length=length)
        reference, timed = self._planner.plan(shorter, Bounds(speed), start)
        return reference, replace(timed, problem=MotionReason.COLLISION.value, detail=touch)

    def _final_axes(
        self, tip: TipState, direction: Array, distance: float, joint: JointEstimate | None
    ) -> list[Array]:
        """Tool axes (3,) to try for the end of a flow step, the best first."""
        params = self._params.flow_step
        axes = led_axes(tip.axis, direction, params.lead, params.max_lead)
        if float(tip.axis @ direction) < 0:
            return axes
        turned = displacement(tip.position, direction, joint, distance)[:3, :3] @ direction
        return [lagging_axis(tip.axis, turned, params.push_lag), *axes]

    def _flow_step(
        self, goal: MotionGoal, direction: Array, seen: RobotObservation, start: JointState
    ) -> RunningMotion | Termination:
        params = self._params.flow_step
        if not seen.vacuum:
            return Termination(MotionReason.SUCTION_LOST, "the cup holds nothing; probe first")
        distance = goal.distance or params.distance
        tip = self._robot.tip(start.position)
        plans = []
        for axis in self._final_axes(tip, direction, distance, goal.joint):
            line = tool_line(tip, direction, distance, axis, distance * params.realign_part)
            plans.append(self._planner.plan(line, Bounds(params.speed), start))
            if plans[-1][1].travel > _ENOUGH * distance:
                break
        reference, timed = max(plans, key=lambda plan: plan[1].travel)
        reference, timed = self._clear_of_table(reference, timed, params.speed, start)
        if timed.trajectory is None:
            problem = timed.problem or "singularity"
            message = f"the arm cannot follow the flow: {timed.detail}"
            return Termination(MotionReason(problem), message)
        reference.offset_bounds = self._planner.offset_bounds(timed, reference.line.direction)
        return FlowStep(self._robot, self._planner, reference, timed, distance, params, seen.time)
