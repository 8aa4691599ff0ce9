"""The doctor's ear: one node that hears everything a robot's graph says."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PointStamped, WrenchStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image, JointState

from flowbothd.doctor.doctor_checks import Heard
from flowbothd.doctor.doctor_touch import WrenchSample
from flowbothd_common.ros.conversions import to_seconds
from flowbothd_common.types import Array
from flowbothd_interfaces.msg import Heartbeat, SuctionMeasurement

_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
_TOPICS: dict[str, Any] = {
    "depth/image_raw": Image,
    "depth/camera_info": CameraInfo,
    "joint_states": JointState,
    "external_wrench": WrenchStamped,
    "suction/measurement": SuctionMeasurement,
}


class Ear:
    """Listens on one ROS domain, best effort, which every publisher serves.

    Attributes:
        heard: By topic.
        positions: Newest joint positions by name [rad].
        forces: Sizes of the forces heard [N].
        wrenches: The forces heard, with their frames.
        end_effector: (3,) newest `arm/end_effector` [m], or None.
        pump_fault: Newest fault of the pump.
        said: Node -> ready, and in its own words.
    """

    def __init__(self, domain: int) -> None:
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = Node("doctor", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self.heard = {name: Heard() for name in _TOPICS}
        self.positions: dict[str, float] = {}
        self.forces: list[float] = []
        self.wrenches: list[WrenchSample] = []
        self.end_effector: Array | None = None
        self.pump_fault = ""
        self.said: dict[str, tuple[bool, str]] = {}
        more: dict[str, Callable[[Any], None]] = {
            "joint_states": self._on_joints,
            "external_wrench": self._on_wrench,
            "suction/measurement": self._on_pump,
        }
        for name, kind in _TOPICS.items():
            self._hear(name, kind, more.get(name))
        listen = self._node.create_subscription
        listen(PointStamped, "arm/end_effector", self._on_end_effector, _QOS)
        listen(Heartbeat, "heartbeat", self._on_heartbeat, _QOS)

    def spin(self, seconds: float) -> None:
        """Take in what comes, for so long at most."""
        self._executor.spin_once(timeout_sec=seconds)

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _hear(self, name: str, kind: Any, more: Callable[[Any], None] | None) -> None:
        heard = self.heard[name]

        def on_message(message: Any) -> None:
            heard.times.append(time.monotonic())
            now = self._node.get_clock().now().nanoseconds * 1e-9
            heard.delays.append(now - to_seconds(message.header.stamp))
            if more is not None:
                more(message)

        self._node.create_subscription(kind, name, on_message, _QOS)

    def _on_joints(self, message: JointState) -> None:
        self.positions.update(zip(message.name, message.position, strict=False))

    def _on_wrench(self, message: WrenchStamped) -> None:
        force = np.array([getattr(message.wrench.force, axis) for axis in "xyz"])
        self.forces.append(float(np.linalg.norm(force)))
        self.wrenches.append(WrenchSample(force, message.header.frame_id))

    def _on_pump(self, message: SuctionMeasurement) -> None:
        self.pump_fault = message.fault_message if message.fault else ""

    def _on_end_effector(self, message: PointStamped) -> None:
        self.end_effector = np.array([message.point.x, message.point.y, message.point.z])

    def _on_heartbeat(self, message: Heartbeat) -> None:
        self.said[message.node] = (message.ready, message.detail)
