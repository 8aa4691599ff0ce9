"""The life of one motion goal: planned in a thread, run by a timer, ended with a reason."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory

from flowbothd_common.errors import FlowBotError, MotionRejectedError
from flowbothd_common.motion import (
    MotionGoal,
    MotionKind,
    MotionReason,
    MotionResult,
    RobotObservation,
)
from flowbothd_common.ros import qos
from flowbothd_common.ros.conversions import to_goal, to_trajectory
from franka_suction_driver.actions_ros import ActiveGoal
from franka_suction_driver.execution.executor import MotionExecutor
from franka_suction_driver.execution.motion_factory import PlannedGoal
from franka_suction_driver.inputs_ros import RobotInputs
from franka_suction_driver.params import MotionNodeParams

_FEEDBACK_PERIOD = 0.1
"""Ten a second are enough for a progress bar [s]."""
_BRAKE_TIME = 1.0
"""Time after which a motion whose clock has stopped counts as ended; braking takes less [s]."""


class GoalRunner:
    """Runs one motion at a time on the motion core.

    Args:
        node: Publishes `joint_trajectory`.
        core: The motion core.
        inputs: The robot's topics.
        params: Of the node.
        finish: Takes the result of every goal.
        show: Takes the trajectories of a dry run.
    """

    def __init__(
        self,
        node: Node,
        core: MotionExecutor,
        inputs: RobotInputs,
        params: MotionNodeParams,
        finish: Callable[[ActiveGoal, MotionResult], None],
        show: Callable[[JointTrajectory], None],
    ) -> None:
        self._core, self._inputs, self._params = core, inputs, params
        self._deliver, self._show = finish, show
        self._goal: ActiveGoal | None = None
        self._planning: Future[PlannedGoal] | None = None
        self._cancelled = ""
        self._needs_wrench = False
        self._give_up_at: float | None = None
        self._last_feedback = 0.0
        self._planner = ThreadPoolExecutor(max_workers=1, thread_name_prefix="planning")
        self._trajectory = node.create_publisher(JointTrajectory, "joint_trajectory", qos.COMMAND)

    def close(self) -> None:
        """Wait for a plan under way; to be called before the node is destroyed."""
        self._planner.shutdown(wait=True, cancel_futures=True)

    @property
    def busy(self) -> bool:
        """Whether a goal is being planned or run."""
        return self._goal is not None

    def accept(self, goal: ActiveGoal) -> None:
        """Plan in the background; malformed and second goals end at once with a reason."""
        try:
            wanted = self._checked(goal)
        except MotionRejectedError as error:
            self._deliver(goal, MotionResult(goal.kind, MotionReason.REJECTED, str(error)))
            return
        guarded = self._guarded(goal.kind)
        stale = self._inputs.stale(guarded=guarded)
        seen = self._inputs.observation()
        if stale or seen is None:
            message = f"cannot move: {stale}; start what should publish it"
            self._deliver(goal, MotionResult(goal.kind, MotionReason.STALE_INPUT, message))
            return
        self._goal = goal
        self._cancelled = ""
        self._give_up_at = None
        # Free motions are possible without a wrench, but one that began with it keeps its guard.
        known = self._inputs.wrench_known()
        self._needs_wrench = guarded or (self._params.require_wrench and known)
        cloud = self._inputs.cloud

        def plan() -> PlannedGoal:
            self._core.set_obstacles(cloud, self._params.camera_position or None)
            return self._core.prepare(wanted, seen)

        self._planning = self._planner.submit(plan)

    def tick(self) -> None:
        """Advance the goal, if there is one."""
        seen = self._inputs.observation()
        if self._goal is None or seen is None:
            return
        if self._planning is not None and not self._begin_planned(self._goal, seen):
            return
        self._run(self._goal, seen)

    def stop(self, message: str) -> bool:
        """Stop what runs or is being planned; returns whether there was anything."""
        self._cancelled = message
        return self._core.stop(MotionReason.STOPPED, message) or self._goal is not None

    def cancel(self, key: bytes) -> bool:
        """Stop the goal with this key; returns whether it is the present one."""
        if self._goal is None or self._goal.key != key:
            return False
        self.stop("the goal was cancelled")
        return True

    def drop(self, why: str) -> None:
        """Brake at once, without the motion that failed, and end its goal.

        Args:
            why: The unexpected exception, in words.
        """
        goal, self._goal, self._planning = self._goal, None, None
        seen = self._inputs.observation()
        try:
            braking = None if seen is None else self._core.drop(seen.time, why)
            if braking is not None:
                self._trajectory.publish(to_trajectory(braking))
        finally:
            if goal is not None:
                message = f"stopped by an internal error: {why}"
                self._deliver(goal, MotionResult(goal.kind, MotionReason.STOPPED, message))

    def _checked(self, goal: ActiveGoal) -> MotionGoal:
        if self._goal is not None:
            raise MotionRejectedError(
                f"{self._goal.kind.value} is still running", hint="wait for it, or stop it"
            )
        frame, base = goal.request.header.frame_id, self._params.robot.base_frame
        if frame not in ("", base):
            raise MotionRejectedError("goal in another frame", got=frame, allowed=base)
        return to_goal(goal.kind, goal.request)

    def _guarded(self, kind: MotionKind) -> bool:
        return self._params.require_wrench and kind in (MotionKind.PROBE, MotionKind.FLOW_STEP)

    def _run(self, goal: ActiveGoal, seen: RobotObservation) -> None:
        """One tick of the running motion."""
        guarded = self._guarded(goal.kind)
        stale = self._inputs.stale(guarded=guarded, wrench=self._needs_wrench)
        if stale and self._give_up_at is None:
            self._give_up_at = time.monotonic() + _BRAKE_TIME
            self._core.stop(MotionReason.STALE_INPUT, f"stopped: {stale}")
        update = self._core.tick(seen)
        if update.trajectory is not None:
            self._trajectory.publish(to_trajectory(update.trajectory))
        if update.shown is not None:
            self._show(update.shown)
        result = update.result
        # With the simulation gone its time stands still, and no braking ever ends.
        if result is None and self._give_up_at is not None and _late(self._give_up_at):
            result = self._core.abandon(seen)
        if result is not None:
            self._finish(goal, result)
        elif _late(self._last_feedback + _FEEDBACK_PERIOD):
            self._last_feedback = time.monotonic()
            goal.feedback(update.fraction)

    def _begin_planned(self, goal: ActiveGoal, seen: RobotObservation) -> bool:
        """Begin once planning is done; returns whether a motion is running now."""
        if self._planning is None or not self._planning.done():
            return False
        planning, self._planning = self._planning, None
        if self._cancelled:
            self._finish(goal, MotionResult(goal.kind, MotionReason.STOPPED, self._cancelled))
            return False
        try:
            self._core.begin(planning.result(), seen)
        except FlowBotError as error:
            self._finish(goal, MotionResult(goal.kind, MotionReason.REJECTED, str(error)))
            return False
        return True

    def _finish(self, goal: ActiveGoal, result: MotionResult) -> None:
        if goal is self._goal:
            self._goal = None
        self._deliver(goal, result)


def _late(deadline: float) -> bool:
    return time.monotonic() > deadline
