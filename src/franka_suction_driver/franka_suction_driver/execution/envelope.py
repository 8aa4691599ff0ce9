"""The safety envelope around all motion: box, force, lag, speed, and a stop that stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flowbothd_common.errors import MotionRejectedError, ParameterError
from flowbothd_common.motion import (
    JointState,
    JointTrajectory,
    MotionGoal,
    MotionReason,
    RobotObservation,
)
from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.execution.lag import LagWatch
from franka_suction_driver.execution.motion_step import Ending
from franka_suction_driver.params import MotionParams, SafetyParams

_BEYOND_REACH = 2.0
_SLACK = 1e-3


class Envelope:
    """Judges goals, trajectories and observations, and remembers a latched stop.

    Args:
        params: Of the envelope.
        kinematics: The arm.

    Raises:
        ParameterError: the workspace box is empty.
    """

    def __init__(self, params: SafetyParams, kinematics: Kinematics) -> None:
        self._params = params
        self._kinematics = kinematics
        self._latched = ""
        self._lag = LagWatch()
        self._box = workspace(params)

    @property
    def latched(self) -> str:
        """Why nothing may move until `release`; empty if it may."""
        return self._latched

    def restart(self) -> None:
        """Another motion begins, from where the arm is."""
        self._lag.restart()

    def latch(self, why: str) -> None:
        """Let nothing move until `release`; the first reason is kept."""
        self._latched = self._latched or why

    def release(self) -> str:
        """Let motion begin again; returns what had stopped it, empty if nothing had."""
        why, self._latched = self._latched, ""
        return why

    def check_goal(self, goal: MotionGoal) -> None:
        """Refuse what cannot be begun at all.

        Raises:
            MotionRejectedError: a stop is latched, or the contact lies outside the workspace.
        """
        if self._latched:
            raise MotionRejectedError(
                f"the stop is latched: {self._latched}",
                hint="make sure that the arm may move, then call motion/release",
            )
        if self._box is None or goal.contact is None:
            return
        low, high = self._box
        contact = np.asarray(goal.contact, dtype=float)
        if not ((contact >= low).all() and (contact <= high).all()):
            raise MotionRejectedError(
                "the contact lies outside the workspace box",
                got=np.round(contact, 3).tolist(),
                allowed=f"{low.tolist()} .. {high.tolist()} m",
                hint="move the object, or change safety.workspace_min and workspace_max",
            )

    def check_observation(self, observation: RobotObservation) -> None:
        """Refuse to begin from values that are not finite.

        Raises:
            MotionRejectedError: some are; it says which.
        """
        problem = observation.problem()
        if problem:
            raise MotionRejectedError(f"cannot move: {problem}")

    def leaves(self, trajectory: JointTrajectory, start: JointState) -> str:
        """Where a trajectory takes the tip out of the box, in words, or nothing.

        An arm that stands outside may come nearer to the box.
        """
        if self._box is None:
            return ""
        low, high = self._box
        path = np.vstack([start.position[None], trajectory.positions])
        tips = self._kinematics.tip(path).position
        excess = np.maximum(np.maximum(low - tips, tips - high), 0.0)
        worst = int(excess.max(axis=1).argmax())
        if excess[worst].max() <= excess[0].max() + _SLACK:
            return ""
        axis = int(excess[worst].argmax())
        return (
            f"the tip would leave the workspace box at {'xyz'[axis]} = {tips[worst, axis]:.3f} m "
            f"(allowed {low[axis]:g} .. {high[axis]:g}); move the object, or change "
            "safety.workspace_min and workspace_max"
        )

    def watch(self, seen: RobotObservation, commanded: JointState) -> Ending | None:
        """What in an observation must end any motion; a force latches the stop as well."""
        params = self._params
        force = 0.0 if seen.wrench is None else float(np.linalg.norm(seen.wrench[:3]))
        if not force <= params.force_limit:
            message = (
                f"{force:.0f} N on the tool (safety.force_limit {params.force_limit:.0f} N): look "
                "what it touches, free it, then call motion/release"
            )
            self.latch(message)
            return Ending(MotionReason.FORCE_LIMIT, message, True)
        lag = self._lag.lag(seen, commanded)
        if lag <= params.lag_limit:
            return None
        message = (
            f"the arm is {lag:.2f} rad off its command and does not follow: the controller holds "
            "it or has rejected the trajectory, or the joint states are frozen; see the driver's "
            "log"
        )
        return Ending(MotionReason.LAGGING, message)


def workspace(params: SafetyParams) -> tuple[Array, Array] | None:
    """Low and high corner (3,) of the workspace [m]; None for a box beyond every reach.

    Raises:
        ParameterError: the box is empty.
    """
    low, high = np.array(params.workspace_min), np.array(params.workspace_max)
    if not (low < high).all():
        raise ParameterError(
            "the workspace box is empty",
            got=f"{low.tolist()} .. {high.tolist()}",
            allowed="safety.workspace_min < workspace_max",
        )
    beyond = (low <= -_BEYOND_REACH).all() and (high >= _BEYOND_REACH).all()
    return None if beyond else (low, high)


def slowed(params: MotionParams) -> MotionParams:
    """The parameters with all speeds, of joints and of the tool, times safety.speed_scale."""
    scale = params.safety.speed_scale
    probe, step = params.probe, params.flow_step
    return replace(
        params,
        robot=replace(params.robot, speed_scale=params.robot.speed_scale * scale),
        probe=replace(probe, speed=probe.speed * scale, free_speed=probe.free_speed * scale),
        flow_step=replace(step, speed=step.speed * scale),
    )
