"""motion_node: the motion actions; plans, moves, watches, and stops when anything goes silent."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

from rclpy.node import Node
from std_msgs.msg import String

from flowbothd_common.ros import qos
from flowbothd_common.ros.diagnostics import ERROR, OK, NodeStatus
from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.liveness import MotionHeartbeat
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from franka_suction_driver.actions_ros import ActiveGoal, MotionActions
from franka_suction_driver.arm.description import read_description
from franka_suction_driver.arm.kinematics import make_kinematics
from franka_suction_driver.arm.limits_text import motion_limits
from franka_suction_driver.execution.executor import MotionExecutor
from franka_suction_driver.execution.goal_runner_ros import GoalRunner
from franka_suction_driver.inputs_ros import RobotInputs
from franka_suction_driver.params import MotionNodeParams
from franka_suction_driver.safety_ros import SafetyServices, open_audit


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
        self._guard = Guard(self, self._on_failure)
        self._inputs = RobotInputs(
            self, self._params, self._core.limits, self._guard, self._on_refused
        )
        self._description = self.create_publisher(String, "robot_description", qos.LATCHED)
        self._description.publish(String(data=kinematics.urdf))
        accept = partial(self._guard.run, "motion goal", self._on_goal)
        self._actions = MotionActions(self, robot.base_frame, accept, self._on_cancel)
        self._safety = SafetyServices(self, self._core, self._on_stop, self._guard)
        self._runner = GoalRunner(
            self,
            self._core,
            self._inputs,
            self._params,
            self._actions.finish,
            self._safety.show,
        )
        self._heartbeat = MotionHeartbeat(self)
        self._status = NodeStatus(self, self._guard)
        self._guard.every(1.0 / self._params.rate, self._on_timer)

    def destroy_node(self) -> None:
        """Stop the heartbeats first, so that the arm's driver holds the arm."""
        self._heartbeat.close()
        self._status.close()
        self._runner.close()
        self._actions.destroy()
        if self._audit is not None:
            self._audit.close()
        super().destroy_node()

    def _on_goal(self, goal: ActiveGoal) -> None:
        self._runner.accept(goal)

    def _on_cancel(self, key: bytes) -> bool:
        return self._runner.cancel(key)

    def _on_stop(self, message: str) -> bool:
        return self._runner.stop(message)

    def _on_refused(self) -> None:
        self._guard.run("motion", self._runner.tick)

    def _on_timer(self) -> None:
        stale = self._inputs.stale(guarded=False)
        latched = self._core.latched and f"stopped until motion/clear_stop: {self._core.latched}"
        stuck = self._heartbeat.silent and "cannot brake after an error, see the log: restart it"
        trouble = stuck or stale or latched
        level = ERROR if trouble else OK
        self._status.report(level, trouble or "ready to move", {"moving": self._runner.busy})
        self._runner.tick()

    def _on_failure(self, why: str) -> None:
        """Bring the arm to rest after an unexpected exception.

        Without a way to brake, the heartbeat stops: the arm's driver then holds the arm.
        """
        try:
            self._runner.drop(why)
        except Exception:
            self._heartbeat.silence()
            raise


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(MotionNode, args, strict_files=True)


if __name__ == "__main__":
    sys.exit(main())
