"""motion_node: the motion actions; plans, moves, watches, and stops when anything goes silent."""

from __future__ import annotations

import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import String
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
from flowbothd_common.ros.diagnostics import ERROR, OK, NodeStatus
from flowbothd_common.ros.liveness import MotionHeartbeat
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from franka_suction_driver.actions_ros import ActiveGoal, MotionActions
from franka_suction_driver.description import read_description
from franka_suction_driver.executor import MotionExecutor, make_kinematics
from franka_suction_driver.inputs_ros import RobotInputs
from franka_suction_driver.limits_text import motion_limits
from franka_suction_driver.motion_factory import Prepared
from franka_suction_driver.params import MotionNodeParams
from franka_suction_driver.safety_ros import SafetyServices, open_audit

_FEEDBACK_PERIOD = 0.1
_BRAKE_TIME = 1.0


class MotionNode(Node):
    """One motion at a time, planned in a thread of its own and run from a steady timer."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("motion_node", **kwargs)
        self._params = declare(self, MotionNodeParams)
        self.get_logger().info(motion_limits(self._params))
        robot = self._params.robot
        kinematics = make_kinematics(self._params, read_description(robot.description_file))
        self._audit = open_audit(self._params.safety)
        self._core = MotionExecutor(kinematics, self._params, audit=self._audit)
        self._inputs = RobotInputs(
            self,
            robot.joint_names,
            robot.base_frame,
            watch_nodes=self._params.watch_nodes,
            ready_nodes=self._params.ready_nodes,
            timeout=self._params.watch_timeout,
            input_timeout=self._params.input_timeout,
        )
        self._goal: ActiveGoal | None = None
        self._planning: Future[Prepared] | None = None
        self._cancelled = ""
        self._give_up_at: float | None = None
        self._last_feedback = 0.0
        self._planner = ThreadPoolExecutor(max_workers=1, thread_name_prefix="planning")
        self._trajectory = self.create_publisher(JointTrajectory, "joint_trajectory", qos.COMMAND)
        self._description = self.create_publisher(String, "robot_description", qos.LATCHED)
        self._description.publish(String(data=kinematics.urdf))
        self._actions = MotionActions(self, robot.base_frame, self._accept, self._on_cancel)
        self._safety = SafetyServices(self, self._core, self._stop)
        self._heartbeat = MotionHeartbeat(self)
        self._status = NodeStatus(self)
        # Runs on when simulated time stands still, to notice that it does.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / self._params.rate, self._on_timer, clock=steady)

    def destroy_node(self) -> None:
        """Stop the heartbeats first: whoever moves the arm then holds."""
        self._heartbeat.close()
        self._status.close()
        self._planner.shutdown(wait=True, cancel_futures=True)
        self._actions.destroy()
        if self._audit is not None:
            self._audit.close()
        super().destroy_node()

    def _accept(self, goal: ActiveGoal) -> None:
        """Plan in the background; malformed and second goals end at once with a reason."""
        try:
            wanted = self._checked(goal)
        except MotionRejectedError as error:
            self._finish(goal, MotionResult(goal.kind, MotionReason.REJECTED, str(error)))
            return
        stale = self._inputs.stale(guarded=self._guarded(goal.kind))
        seen = self._inputs.observation()
        if stale or seen is None:
            message = f"cannot move: {stale}; start what should publish it"
            self._finish(goal, MotionResult(goal.kind, MotionReason.STALE_INPUT, message))
            return
        self._goal, self._cancelled, self._give_up_at = goal, "", None
        cloud = self._inputs.cloud

        def plan() -> Prepared:
            self._core.set_obstacles(cloud, self._params.camera_position or None)
            return self._core.prepare(wanted, seen)

        self._planning = self._planner.submit(plan)

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

    def _on_timer(self) -> None:
        stale = self._inputs.stale(guarded=False)
        latched = self._core.latched and f"stopped until motion/release: {self._core.latched}"
        trouble = stale or latched
        level = ERROR if trouble else OK
        self._status.report(level, trouble or "ready to move", {"moving": self._goal is not None})
        seen = self._inputs.observation()
        if self._goal is None or seen is None:
            return
        if self._planning is not None and not self._begin_planned(self._goal, seen):
            return
        self._run(self._goal, seen)

    def _run(self, goal: ActiveGoal, seen: RobotObservation) -> None:
        """One tick of the running motion."""
        stale = self._inputs.stale(guarded=self._guarded(goal.kind))
        if stale and self._give_up_at is None:
            self._give_up_at = time.monotonic() + _BRAKE_TIME
            self._core.stop(MotionReason.STALE_INPUT, f"stopped: {stale}")
        update = self._core.tick(seen)
        if update.trajectory is not None:
            self._trajectory.publish(to_trajectory(update.trajectory))
        if update.shown is not None:
            self._safety.show(update.shown)
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
        """Begin once planning is done; whether a motion is running now."""
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
        self._actions.finish(goal, result)

    def _stop(self, message: str) -> bool:
        self._cancelled = message
        return self._core.stop(MotionReason.STOPPED, message) or self._goal is not None

    def _on_cancel(self, key: bytes) -> bool:
        if self._goal is None or self._goal.key != key:
            return False
        self._stop("the goal was cancelled")
        return True


def _late(deadline: float) -> bool:
    return time.monotonic() > deadline


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(MotionNode, args, strict_files=True)


if __name__ == "__main__":
    sys.exit(main())
