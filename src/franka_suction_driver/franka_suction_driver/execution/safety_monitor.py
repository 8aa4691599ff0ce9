"""Safety monitor of all motion: workspace, force, tracking error, speed and the latched stop."""

from __future__ import annotations

from collections import deque
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
from franka_suction_driver.execution.motion_step import Termination
from franka_suction_driver.params import MotionParams, SafetyParams

_BEYOND_REACH = 2.0
"""A workspace box that reaches this far on all sides is no restriction [m]: the arm and its tool
reach little more than a metre from the base."""
_SLACK = 1e-3
"""Excess over the box that is accepted [m]: splines and quintics deviate from the planned poses by
less than this."""
_DELAY = 0.25
"""Oldest command that an arm may still be following [s]: trajectories and joint states travel
through the graph, and a controller starts one at its next cycle."""


class SafetyMonitor:
    """Judge goals, trajectories and observations, and hold the latched stop.

    Args:
        params: Limits to hold.
        kinematics: The arm.

    Raises:
        ParameterError: the workspace box is empty.
    """

    def __init__(self, params: SafetyParams, kinematics: Kinematics) -> None:
        self._params = params
        self._kinematics = kinematics
        self._latched = ""
        self._tracking = TrackingErrorWatch()
        self._box = workspace(params)

    @property
    def latched(self) -> str:
        """Reason why nothing may move until `clear_stop`; empty if the arm may move."""
        return self._latched

    def restart(self) -> None:
        """Begin watching another motion, from where the arm is."""
        self._tracking.restart()

    def latch(self, why: str) -> None:
        """Refuse all motion until `clear_stop`; the first reason is kept."""
        self._latched = self._latched or why

    def clear_stop(self) -> str:
        """Allow motion again; return the latched reason, empty if there was none."""
        why, self._latched = self._latched, ""
        return why

    def check_goal(self, goal: MotionGoal) -> None:
        """Refuse a goal that must not begin.

        Raises:
            MotionRejectedError: a stop is latched, or the contact lies outside the workspace.
        """
        if self._latched:
            raise MotionRejectedError(
                f"the stop is latched: {self._latched}",
                hint="make sure that the arm may move, then call motion/clear_stop",
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
        """Return where a trajectory takes the tip out of the box, in words; empty if it does not.

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

    def watch(self, seen: RobotObservation, commanded: JointState) -> Termination | None:
        """Return why an observation must end any motion, or None; a force also latches the stop."""
        params = self._params
        force = 0.0 if seen.wrench is None else float(np.linalg.norm(seen.wrench[:3]))
        if not force <= params.force_limit:
            message = (
                f"{force:.0f} N on the tool (safety.force_limit {params.force_limit:.0f} N): look "
                "what it touches, free it, then call motion/clear_stop"
            )
            self.latch(message)
            return Termination(MotionReason.FORCE_LIMIT, message, True)
        error = self._tracking.error(seen, commanded)
        if error <= params.lag_limit:
            return None
        message = (
            f"the arm is {error:.2f} rad off its command and does not follow: the controller holds "
            "it or has rejected the trajectory, or the joint states are frozen; see the driver's "
            "log"
        )
        return Termination(MotionReason.LAGGING, message)


class TrackingErrorWatch:
    """Tracking error that ignores a constant delay: distance from every recently commanded state.

    An arm that follows late is where the command was a moment ago, however fast it moves. A blocked
    arm soon differs from every recently commanded state. So a small limit separates the two.
    """

    def __init__(self) -> None:
        self._lately: deque[tuple[float, Array]] = deque()

    def restart(self) -> None:
        """Forget what was commanded: another motion begins."""
        self._lately.clear()

    def error(self, seen: RobotObservation, commanded: JointState) -> float:
        """Return the largest distance of a joint from its recently commanded positions [rad].

        Args:
            seen: What is measured.
            commanded: Joint state that the arm is commanded to have at `seen.time`.
        """
        self._lately.append((seen.time, commanded.position))
        # One position from before the window is kept: the way from there into the window counts.
        while len(self._lately) > 1 and self._lately[1][0] <= seen.time - _DELAY:
            self._lately.popleft()
        way = np.array([position for _, position in self._lately])
        below, above = way.min(axis=0) - seen.positions, seen.positions - way.max(axis=0)
        return float(np.maximum(below, above).max())


def workspace(params: SafetyParams) -> tuple[Array, Array] | None:
    """Return low and high corner (3,) of the workspace [m]; None for a box beyond every reach.

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
    """Return the parameters with all joint and tool speeds scaled by safety.speed_scale."""
    scale = params.safety.speed_scale
    probe, step = params.probe, params.flow_step
    return replace(
        params,
        robot=replace(params.robot, speed_scale=params.robot.speed_scale * scale),
        probe=replace(probe, speed=probe.speed * scale, free_speed=probe.free_speed * scale),
        flow_step=replace(step, speed=step.speed * scale),
    )
