"""The simulated robot, camera and pump behind the topics that the real ones have."""

from __future__ import annotations

import time
from typing import Any

from rclpy.node import Node
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory

from flowbothd_common.errors import FlowBotError
from flowbothd_common.ros import qos
from flowbothd_common.ros.clouds import XYZ, from_cloud_message, to_flow_message
from flowbothd_common.ros.conversions import from_pose, from_trajectory, to_pose, to_seconds
from flowbothd_common.ros.diagnostics import ERROR, OK, WARN, NodeStatus
from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from flowbothd_interfaces.msg import SuctionCommand
from flowbothd_interfaces.srv import GroundTruthFlow, ResetSim
from sim_bridge.outputs_ros import BridgeOutputs
from sim_bridge.pacing import Pacer, Watchdog
from sim_bridge.params import BridgeParams
from sim_bridge.session import Session, Setup, initial_setup

_POLL = 0.004
"""Period of the timer that keeps the simulation in real time [s]."""


class BridgeNode(Node):
    """Steps the world in real time and carries messages to and from it."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("bridge_node", **kwargs)
        self._params = declare(self, BridgeParams)
        self._session: Session | None = None
        self._description = ""
        self._trouble = ""
        self._setup = initial_setup(self._params)
        # The object is looked at before anything else: a typing mistake ends the node at once.
        self._setup.load()
        self._watchdog = Watchdog(self._params.heartbeat_timeout)
        self._holding = False
        self._vacuum = 0.0
        self._outputs = BridgeOutputs(self, self._params)
        self._guard = Guard(self, self._on_failure)
        self._create_inputs()
        self.status = NodeStatus(self, self._guard)
        self._pacer = Pacer(self._params.arm.time_step)
        self._timer = self._guard.every(_POLL, self._on_poll)
        self._report()

    def destroy_node(self) -> None:
        """Disconnect from PyBullet and stop the heartbeat."""
        self._timer.cancel()
        self.status.close()
        if self._session is not None:
            self._session.close()
            self._session = None
        super().destroy_node()

    def _create_inputs(self) -> None:
        listen, serve = self._guard.subscribe, self._guard.serve
        listen(String, "robot_description", self._on_description, qos.LATCHED)
        listen(JointTrajectory, "joint_trajectory", self._on_trajectory, qos.COMMAND)
        listen(SuctionCommand, "suction/command", self._on_suction, qos.COMMAND)
        listen(Header, "motion/heartbeat", self._on_heartbeat, qos.HEARTBEAT)
        serve(ResetSim, "sim/reset", self._on_reset)
        serve(GroundTruthFlow, "sim/ground_truth_flow", self._on_ground_truth)

    def _on_failure(self, _: str) -> None:
        """Hold the arm: the last command may be what broke the world."""
        if self._session is not None:
            self._session.world.hold()

    def _needed_session(self) -> Session:
        if self._session is None:
            raise FlowBotError("there is no world yet", hint=self._trouble or "start motion_node")
        return self._session

    def _on_description(self, message: String) -> None:
        if message.data == self._description:
            return
        self._description = message.data
        try:
            session = Session(message.data, self._params, self._setup)
        except FlowBotError as error:
            self._trouble = f"robot_description cannot be used: {error}"
            return
        if self._session is not None:
            self._session.close()
        self._session, self._trouble = session, ""
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._outputs.restart()
        self._vacuum = 0.0
        self._pacer.skip(time.monotonic())

    def _on_heartbeat(self, _: Header) -> None:
        self._watchdog.heard(time.monotonic())

    def _on_trajectory(self, message: JointTrajectory) -> None:
        session = self._session
        if session is None or self._holding:
            reason = "there is no world yet" if session is None else "motion/heartbeat is silent"
        else:
            stamp = to_seconds(message.header.stamp)
            begin = session.world_time(stamp) if stamp else 0.0
            reason = session.world.command_trajectory(from_trajectory(message), begin)
        if reason:
            self.get_logger().warning(f"joint_trajectory rejected: {reason}")
            self._guard.refuse("joint_trajectory", reason)

    def _on_suction(self, message: SuctionCommand) -> None:
        try:
            self._needed_session().world.command_suction(message.vacuum)
            self._vacuum = message.vacuum
        except (FlowBotError, ValueError) as error:
            self.get_logger().warning(f"suction/command rejected: {error}")
            self._guard.refuse("suction/command", str(error))

    def _on_poll(self) -> None:
        now = time.monotonic()
        silent = self._watchdog.silent(now)
        session = self._session
        if session is not None:
            if silent and not self._holding:
                session.world.hold()
            self._holding = silent
            for _ in range(self._pacer.due(now)):
                session.world.step()
                factor = self._pacer.factor()
                self._outputs.publish(session, self._vacuum, factor, holding=self._holding)
            self._outputs.expose()
        self._report()

    def _report(self) -> None:
        if self._session is None:
            missing = self._trouble or "waiting for robot_description from motion_node"
            self.status.report(ERROR, missing)
        elif self._holding:
            self.status.report(WARN, "motion/heartbeat is silent: the arm holds")
        else:
            model = self._session.world.model
            name = f"{model.name} {model.mode}".strip()
            factor = {"real_time_factor": f"{self._pacer.factor():.2f}"}
            self.status.report(OK, f"simulating {name}", factor)

    def _on_reset(
        self, request: ResetSim.Request, response: ResetSim.Response
    ) -> ResetSim.Response:
        try:
            session = self._needed_session()
            session.reset(_requested(request, session))
            self._setup = session.setup
            self._begin_anew()
            response.ok = True
        except (FlowBotError, ValueError) as error:
            response.ok, response.message = False, str(error)
        if self._session is not None:
            world = self._session.world
            response.object, response.mode = world.model.name, world.model.mode
            response.pose = to_pose(world.object_pose)
        return response

    def _on_ground_truth(
        self, request: GroundTruthFlow.Request, response: GroundTruthFlow.Response
    ) -> GroundTruthFlow.Response:
        try:
            world = self._needed_session().world
            points = from_cloud_message(request.cloud, XYZ).reshape(-1, 3)
            truth = world.ground_truth_flow(points)
        except FlowBotError as error:
            response.ok, response.message = False, str(error)
            return response
        response.flows = to_flow_message(request.cloud.header, points, truth.flows)
        response.modes = list(truth.modes)
        response.open_ratio = truth.open_ratio
        response.ok = True
        return response


def _requested(request: ResetSim.Request, session: Session) -> Setup:
    present = session.setup
    name = request.object or present.object
    pose = from_pose(request.pose) if not request.use_default_pose else None
    if request.use_default_pose and name == present.object:
        pose = present.pose
    return Setup(name, request.mode, request.target_joint, pose, request.seed)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(BridgeNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
