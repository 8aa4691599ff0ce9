"""What the motion node hears of the robot: latest values, and who has gone silent."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState, PointCloud2

from flowbothd_common.errors import FlowBotError
from flowbothd_common.motion import RobotObservation, joint_order
from flowbothd_common.ros import clouds, qos
from flowbothd_common.ros.conversions import from_wrench
from flowbothd_common.ros.liveness import PeerWatch, Silence
from flowbothd_common.types import Array, Cloud, as_cloud
from flowbothd_interfaces.msg import SuctionState

JOINT_STATES = "joint_states"
WRENCH = "external_wrench"
SUCTION = "suction/state"


class RobotInputs:
    """Latest joint states, wrench, suction state and object cloud.

    Args:
        node: Subscribes on it.
        joint_names: The order of all joint vectors.
        base_frame: Frame that clouds and wrenches must be in.
        watch_nodes: Nodes whose heartbeat is watched as well.
        ready_nodes: Those of them that must also say that they are ready.
        timeout: Silence of nodes and suction on the steady clock that counts as stale [s].
        input_timeout: Silence of joint states and wrench that counts as stale [s].
    """

    def __init__(
        self,
        node: Node,
        joint_names: Sequence[str],
        base_frame: str,
        *,
        watch_nodes: Sequence[str],
        ready_nodes: Sequence[str],
        timeout: float,
        input_timeout: float,
    ) -> None:
        self._node = node
        self._names = tuple(joint_names)
        self._base_frame = base_frame
        self._silence = Silence(input_timeout)
        self._suction_silence = Silence(timeout)
        self._ready = frozenset(ready_nodes)
        self._peers = PeerWatch(node, watch_nodes, timeout)
        self._positions: Array | None = None
        self._velocities: Array = np.zeros(len(self._names))
        self._wrench: Array | None = None
        self._vacuum = self._vacuum_lost = False
        self.cloud: Cloud | None = None
        node.create_subscription(JointState, JOINT_STATES, self._on_joints, qos.STATE)
        # Franka's drivers publish wrenches best effort: a reliable reader would get nothing.
        node.create_subscription(WrenchStamped, WRENCH, self._on_wrench, qos.SENSOR)
        node.create_subscription(SuctionState, SUCTION, self._on_suction, qos.STATE)
        node.create_subscription(PointCloud2, "object_cloud", self._on_cloud, qos.IMAGE)

    def observation(self) -> RobotObservation | None:
        """What is known of the robot now, on the node clock; None before any joint state."""
        if self._positions is None:
            return None
        now = self._node.get_clock().now().nanoseconds * 1e-9
        silent = self._silence.silent([WRENCH])
        return RobotObservation(
            now,
            self._positions,
            self._velocities,
            None if silent else self._wrench,
            self._vacuum,
            self._vacuum_lost,
        )

    def stale(self, *, guarded: bool) -> str:
        """Which inputs are silent, in words; empty if none.

        Args:
            guarded: The motion needs wrench and suction state, too.
        """
        parts = []
        for silence, names in (
            (self._silence, [JOINT_STATES, WRENCH] if guarded else [JOINT_STATES]),
            (self._suction_silence, [SUCTION] if guarded else []),
        ):
            for name in silence.silent(names):
                age = silence.age(name)
                parts.append(f"no {name} yet" if np.isinf(age) else f"no {name} for {age:.1f} s")
        parts += [f"{name} {problem}" for name, problem in self._lost_peers().items()]
        return ", ".join(parts)

    def _lost_peers(self) -> dict[str, str]:
        """Watched nodes that are silent, and of the arm's nodes those that are not ready."""
        stopping = set(self._peers.silent()) | self._ready
        return {name: text for name, text in self._peers.missing().items() if name in stopping}

    def _on_joints(self, message: JointState) -> None:
        try:
            order = joint_order(self._names, message.name)
        except KeyError as error:
            self._complain(f"joint_states without our joints: {error.args[0]}")
            return
        self._positions = np.array(message.position)[order]
        if len(message.velocity) == len(message.name):
            self._velocities = np.array(message.velocity)[order]
        self._silence.heard(JOINT_STATES, time.monotonic())

    def _on_wrench(self, message: WrenchStamped) -> None:
        self._wrench = from_wrench(message.wrench)
        self._silence.heard(WRENCH, time.monotonic())

    def _on_suction(self, message: SuctionState) -> None:
        self._vacuum = message.state == SuctionState.HOLDING
        self._vacuum_lost = message.state == SuctionState.LOST
        self._suction_silence.heard(SUCTION, time.monotonic())

    def _on_cloud(self, message: PointCloud2) -> None:
        if message.header.frame_id != self._base_frame:
            self._complain(
                f"object_cloud is in frame {message.header.frame_id!r}, it must be in "
                f"{self._base_frame!r}"
            )
            return
        try:
            values = clouds.from_cloud_message(message, clouds.XYZ).reshape(-1, 3)
            self.cloud = as_cloud(values, "object cloud", min_points=0)
        except FlowBotError as error:
            self._complain(str(error))

    def _complain(self, text: str) -> None:
        self._node.get_logger().error(text, throttle_duration_sec=2.0)
