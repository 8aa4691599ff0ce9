"""arm_node: what a robot's driver is to the topics; holds the arm when nobody beats."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import PointStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from flowbothd_common.errors import InvalidMessageError
from flowbothd_common.ros import qos, received
from flowbothd_common.ros.conversions import to_point, to_wrench
from flowbothd_common.ros.diagnostics import ERROR, OK, WARN, NodeStatus
from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.liveness import Silence
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from franka_suction_driver.arm.description import read_description
from franka_suction_driver.arm.kinematics import make_kinematics
from franka_suction_driver.arm.limits import robot_limits
from franka_suction_driver.arm.limits_text import arm_limits
from franka_suction_driver.backend_params import ArmNodeParams
from franka_suction_driver.backends.connection import Connection
from franka_suction_driver.backends.mock import MockLibrary, MockRobot
from franka_suction_driver.backends.panda import PandaArm
from franka_suction_driver.backends.protocol import NOTHING_TO_RECOVER, ArmBackend, ArmState
from franka_suction_driver.backends.topic_ros import TopicArm
from franka_suction_driver.params import MotionParams

_BEAT = "motion/heartbeat"
_STAMP_TOLERANCE = 0.5
"""A trajectory begins when it arrives; one stamped for another time is refused [s]."""


class ArmNode(Node):
    """Joint states and wrench out, trajectories in; a process of its own beside the planner."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("arm_node", **kwargs)
        self._params = declare(self, ArmNodeParams)
        self.get_logger().info(arm_limits(self._params))
        self._names = self._params.robot.joint_names
        self._frame = self._params.robot.base_frame
        self._guard = Guard(self, lambda _: self._backend.hold())
        self._backend = self._make_backend()
        self._silence = Silence(self._params.heartbeat_timeout)
        self._holding = True
        self._refused = ""
        self._connection = Connection(
            self._backend.connect, self._params.reconnect_period, "the robot"
        )
        if self._params.backend != "topic":
            self._joints = self.create_publisher(JointState, "joint_states", qos.STATE)
            self._wrench = self.create_publisher(WrenchStamped, "external_wrench", qos.STATE)
            self._tip = self.create_publisher(PointStamped, "arm/end_effector", qos.STATE)
        listen, serve = self._guard.subscribe, self._guard.serve
        listen(JointTrajectory, "joint_trajectory", self._on_trajectory, qos.COMMAND)
        listen(Header, _BEAT, lambda _: self._silence.heard(_BEAT), qos.HEARTBEAT)
        serve(Trigger, "arm/recover", self._on_recover)
        serve(Trigger, "arm/tare", self._on_tare)
        self._status = NodeStatus(self, self._guard)
        self._guard.every(1.0 / self._params.rate, self._on_timer)

    def destroy_node(self) -> None:
        """Brake and disconnect, whatever ends the node."""
        self._connection.close()
        self._backend.close()
        self._status.close()
        super().destroy_node()

    def _make_backend(self) -> ArmBackend:
        params = self._params
        motion = MotionParams(robot=params.robot)
        kinematics = make_kinematics(motion, read_description(params.robot.description_file))
        limits = robot_limits(kinematics, params.robot)
        if params.backend == "topic":
            lag, tolerance = params.reject_lag, params.start_tolerance
            return TopicArm(self, self._names, limits, lag, tolerance, self._guard)
        if params.backend == "panda":
            tolerance = params.start_tolerance
            return PandaArm(kinematics, limits, params.panda, start_tolerance=tolerance)
        robot = MockRobot(params.robot.start_positions)
        robot.fk = kinematics.pose
        # A wrench of exact zeros would mean a singularity.
        robot.wrench[2] = 1e-6
        address = replace(params.panda, robot_ip=params.panda.robot_ip or "mock")
        library = MockLibrary(robot)
        tolerance = params.start_tolerance
        return PandaArm(kinematics, limits, address, library=library, start_tolerance=tolerance)

    def _on_timer(self) -> None:
        if not self._connection.poll():
            self._status.report(ERROR, self._connection.trouble)
            return
        silent = bool(self._silence.silent([_BEAT]))
        if silent and not self._holding:
            self._backend.hold()
        self._holding = silent
        state = self._backend.state()
        if state is not None:
            self._publish(state)
        self._report(state)

    def _publish(self, state: ArmState) -> None:
        # A state that is sent again with a new stamp would pass for a measurement of now.
        if self._params.backend == "topic" or not state.fresh:
            return
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self._frame)
        self._joints.publish(
            JointState(
                header=header,
                name=list(self._names),
                position=state.positions.tolist(),
                velocity=state.velocities.tolist(),
            )
        )
        if state.tip is not None:
            self._tip.publish(PointStamped(header=header, point=to_point(state.tip)))
        # What is not known is not published: motion then stops for want of a wrench.
        if state.wrench is not None:
            self._wrench.publish(WrenchStamped(header=header, wrench=to_wrench(state.wrench)))

    def _report(self, state: ArmState | None) -> None:
        if state is None:
            self._status.report(ERROR, "no joint states from the robot yet")
        elif state.fault:
            self._status.report(ERROR, state.fault)
        elif self._holding:
            self._status.report(WARN, f"{_BEAT} is silent: the arm holds")
        elif self._refused:
            self._status.report(WARN, f"refused a trajectory: {self._refused}")
        else:
            self._status.report(OK, f"following, backend {self._params.backend}")

    def _on_trajectory(self, message: JointTrajectory) -> None:
        if not self._connection.made:
            self._refused = self._connection.trouble
        elif self._holding:
            self._refused = f"{_BEAT} is silent"
        else:
            try:
                trajectory = received.trajectory(message, self._names)
                now = self.get_clock().now().nanoseconds * 1e-9
                received.StampCheck(_STAMP_TOLERANCE).check("trajectory", message.header.stamp, now)
                self._refused = self._backend.follow(trajectory)
            except InvalidMessageError as error:
                # As for one that does not fit the arm: its sender has lost track.
                self._backend.hold()
                self._refused = str(error)
        if self._refused:
            self.get_logger().warning(f"joint_trajectory refused: {self._refused}")

    def _on_recover(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = (
            self._backend.recover() if self._connection.made else self._connection.trouble
        )
        # Who asks for an arm that is ready has one: success, so that scripts may always ask.
        response.success = response.message in ("", NOTHING_TO_RECOVER)
        self._refused = ""
        return response

    def _on_tare(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = (
            self._backend.tare() if self._connection.made else self._connection.trouble
        )
        response.success = not response.message
        return response


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(ArmNode, args, strict_files=True)


if __name__ == "__main__":
    sys.exit(main())
