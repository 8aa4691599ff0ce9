"""Every node survives malformed messages on every subscription, and requests to every service."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = [pytest.mark.ros, pytest.mark.long]

DOMAIN = 79
MOST = 40
"""Malformations sent to one topic or service; a larger message has more than are needed."""

NODES: dict[str, tuple[str, dict[str, Any]]] = {
    "bridge_node": ("sim_bridge.bridge_node.BridgeNode", {}),
    "perception_node": (
        "flowbothd_perception.perception_node.PerceptionNode",
        {"camera.position": [0.5, 0.0, 1.0], "camera.quaternion": [1.0, 0.0, 0.0, 0.0]},
    ),
    "perception_node, clouds": (
        "flowbothd_perception.perception_node.PerceptionNode",
        {
            "camera.position": [0.5, 0.0, 1.0],
            "camera.quaternion": [1.0, 0.0, 0.0, 0.0],
            "input": "cloud",
        },
    ),
    "inference_node": (
        "flowbothd_policy.inference_node.InferenceNode",
        {"model_path": "compact-procedural"},
    ),
    "oracle_node": ("sim_bridge.oracle_node.OracleNode", {"truth_timeout": 0.1}),
    "policy_node": ("flowbothd_policy.policy_node.PolicyNode", {"service_timeout": 0.5}),
    "motion_node": ("franka_suction_driver.motion_node.MotionNode", {}),
    "suction_node": ("franka_suction_driver.suction.suction_node.SuctionNode", {}),
    "arm_node": ("franka_suction_driver.arm_node.ArmNode", {"backend": "mock"}),
    "pump_node": ("franka_suction_driver.pump_node.PumpNode", {"backend": "mock"}),
}
SKIPPED = ("/clock", "/parameter_events", "_action/")


@pytest.fixture
def executor(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, Any]]:
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    executor = SingleThreadedExecutor(context=context)
    yield context, executor
    executor.shutdown()
    rclpy.shutdown(context=context)


def until(executor: Any, condition: Callable[[], bool], what: str, seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"{what} did not come in {seconds} s"
        executor.spin_once(timeout_sec=0.005)


def good(kind: type) -> Any:
    """A message of a type with content in the fields that nodes look at."""
    from flowbothd_common.ros import clouds

    message = kind()
    name = kind.__name__
    if name == "PointCloud2":
        return clouds.to_cloud_message(_header("panda_link0"), np.ones((6, 3)), clouds.XYZ)
    if name == "JointState":
        message.name = [f"panda_joint{i}" for i in range(1, 8)]
        message.position, message.velocity = [0.1] * 7, [0.0] * 7
    elif name == "JointTrajectory":
        message.joint_names = [f"panda_joint{i}" for i in range(1, 8)]
        message.points = [_point(0.1), _point(0.2)]
    elif name == "Image":
        message.height, message.width, message.step, message.encoding = 2, 4, 8, "16UC1"
        message.data = bytes(16)
    elif name == "CameraInfo":
        message.height, message.width, message.distortion_model = 2, 4, "plumb_bob"
        message.k = [100.0, 0.0, 2.0, 0.0, 100.0, 1.0, 0.0, 0.0, 1.0]
        message.d = [0.0] * 5
    for field in ("cloud", "history"):
        if hasattr(message, field):
            setattr(message, field, good(clouds.PointCloud2))
    if hasattr(message, "header"):
        message.header = _header("panda_link0")
    return message


def _header(frame: str) -> Any:
    from builtin_interfaces.msg import Time
    from std_msgs.msg import Header

    seconds = time.time()
    return Header(frame_id=frame, stamp=Time(sec=int(seconds), nanosec=int(seconds % 1 * 1e9)))


def _point(seconds: float) -> Any:
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectoryPoint

    zero = [0.0] * 7
    return JointTrajectoryPoint(
        positions=[0.1] * 7,
        velocities=zero,
        accelerations=zero,
        time_from_start=Duration(nanosec=int(seconds * 1e9)),
    )


def some(messages: list[Any]) -> list[Any]:
    """At most MOST messages, spread over all of them."""
    step = max(1, len(messages) // MOST)
    return messages[::step]


@pytest.mark.parametrize("name", list(NODES))
def test_no_malformed_message_or_request_ends_a_node(executor: Any, name: str) -> None:
    """The incident: joint states without positions ended motion_node and arm_node at once."""
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    from flowbothd_common.ros.malformed import malformations

    context, spinner = executor
    path, values = NODES[name]
    module, _, cls = path.rpartition(".")
    parameters = [Parameter(key, value=value) for key, value in values.items()]
    node = getattr(importlib.import_module(module), cls)(
        context=context, parameter_overrides=parameters
    )
    sender = Node("sender", context=context)
    spinner.add_node(node)
    spinner.add_node(sender)
    sent = refused = 0
    try:
        for subscription in list(node.subscriptions):
            topic, kind = subscription.topic_name, subscription.msg_type
            if any(part in topic for part in SKIPPED):
                continue
            publisher = sender.create_publisher(kind, topic, subscription.qos_profile)
            until(spinner, lambda p=publisher: p.get_subscription_count() > 0, topic)
            for _, bad in some(list(malformations(good(kind)))):
                publisher.publish(bad)
                sent += 1
                for _ in range(3):
                    spinner.spin_once(timeout_sec=0.002)
        for service in list(node.services):
            if service.srv_name.startswith(node.get_fully_qualified_name()):
                continue
            client = sender.create_client(service.srv_type, service.srv_name)
            until(spinner, client.service_is_ready, service.srv_name)
            requests = [bad for _, bad in malformations(good(service.srv_type.Request))]
            for request in some(requests) or [service.srv_type.Request()]:
                answer = client.call_async(request)
                until(spinner, answer.done, f"an answer of {service.srv_name}")
                response = answer.result()
                refused += not getattr(response, "success", getattr(response, "ok", True))
                sent += 1
        for _ in range(50):
            spinner.spin_once(timeout_sec=0.005)
        failures = [text for text in node_guard(node).troubles() if " failed: " in text]
        assert failures == []
        assert sent > 0
    finally:
        for each in (node, sender):
            spinner.remove_node(each)
            each.destroy_node()


def node_guard(node: Any) -> Any:
    """The guard of a node, wherever it keeps it."""
    from flowbothd_common.ros.guard import Guard

    found = [value for value in vars(node).values() if isinstance(value, Guard)]
    return found[0] if found else node._status._guard
