"""The safety envelope's face to ROS: halt and clear_stop, what a dry run shows, the audit log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rclpy.node import Node
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

from flowbothd_common.motion import JointTrajectory
from flowbothd_common.ros import qos
from flowbothd_common.ros.conversions import to_trajectory
from flowbothd_common.ros.guard import Guard
from franka_suction_driver.execution.audit import AuditLog
from franka_suction_driver.execution.executor import MotionExecutor
from franka_suction_driver.params import SafetyParams


def open_audit(params: SafetyParams) -> AuditLog | None:
    """The audit log that the parameters ask for.

    Raises:
        ParameterError: it cannot be written.
    """
    if not params.audit_log:
        return None
    return AuditLog(Path(params.audit_log).expanduser(), params.audit_size)


class SafetyServices:
    """Services `motion/stop`, `motion/halt`, `motion/clear_stop`; topic `motion/planned`.

    Args:
        node: Serves on it.
        core: The motion core.
        stop: Stops what runs or is being planned, with a message; whether there was anything.
        guard: Of the node's callbacks.
    """

    def __init__(
        self, node: Node, core: MotionExecutor, stop: Callable[[str], bool], guard: Guard
    ) -> None:
        self._node, self._core, self._stop = node, core, stop
        self._planned = node.create_publisher(JointTrajectoryMessage, "motion/planned", qos.LATCHED)
        guard.serve(Trigger, "motion/stop", self._on_stop)
        guard.serve(Trigger, "motion/halt", self._on_halt)
        guard.serve(Trigger, "motion/clear_stop", self._on_clear_stop)

    def show(self, trajectory: JointTrajectory) -> None:
        """Publish what a dry run would have sent."""
        self._planned.publish(to_trajectory(trajectory))

    def _now(self) -> float:
        return float(self._node.get_clock().now().nanoseconds * 1e-9)

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        stopped = self._stop("stopped by the stop service")
        response.message = "stopping" if stopped else "nothing was moving"
        return response

    def _on_halt(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        why = "halted by the halt service"
        self._core.halt(why, self._now())
        self._stop(f"{why}; latched until motion/clear_stop")
        response.success = True
        response.message = "halted; nothing moves until motion/clear_stop"
        return response

    def _on_clear_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        why = self._core.clear_stop(self._now())
        response.success = True
        response.message = f"cleared: {why}" if why else "nothing was latched"
        return response
