"""A camera and an arm that publish at full rate, to see whether perception_node keeps up."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from flowbothd_common.environment import node_environment, own_domain
from flowbothd_common.errors import FlowBotError
from flowbothd_common.malloc_tuning import keep_freed_memory, spare_what_stays
from flowbothd_common.parameter_files import write_parameters
from flowbothd_common.transforms import quaternion_from_rotation
from flowbothd_evaluation.benchmarks.perception_scenes import TruthFrame
from sim_bridge.camera import Intrinsics

_START_TIMEOUT = 60.0


@dataclass(frozen=True)
class Load:
    """What is published.

    Attributes:
        kind: depth (with camera_info) or cloud.
        seconds: For how long.
        rate: Frames per second.
        joint_rate: Joint states per second.
    """

    kind: str = "depth"
    seconds: float = 60.0
    rate: float = 30.0
    joint_rate: float = 100.0


@dataclass(frozen=True)
class LoadFigures:
    """How the node did.

    Attributes:
        sent: Frames published.
        reached: Frames that the node says it received.
        answered: Object clouds received for them.
        inside_median_ms: From the node's callback to its publishing, as it reports.
        inside_p99_ms: The same.
        outside_median_ms: From publishing the frame to receiving its cloud.
        outside_p99_ms: The same.
        cpu_share: CPU time of the node's process over the time on the wall.
    """

    sent: int
    reached: int
    answered: int
    inside_median_ms: float
    inside_p99_ms: float
    outside_median_ms: float
    outside_p99_ms: float
    cpu_share: float


def run_load(load: Load, urdf: str, frames: Sequence[TruthFrame]) -> LoadFigures:
    """Start perception_node in a process of its own and feed it.

    Args:
        load: What to publish.
        urdf: The robot description.
        frames: Shown in turn; all of the same mount.

    Raises:
        FlowBotError: the node does not start, or answers nothing.
    """
    import rclpy
    from rclpy.context import Context

    # The part of the camera is played by this process: it must not stop for its own reasons.
    keep_freed_memory()
    spare_what_stays()
    domain = own_domain()
    environment = node_environment(domain)
    if load.kind == "cloud":
        profile = files("flowbothd_common") / "config" / "fastdds_clouds.xml"
        environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile)
    mount = frames[0].mount.T_base_camera
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "parameters.yaml"
        write_parameters(
            file,
            {
                "perception_node": {
                    "input": load.kind,
                    "camera.position": mount[:3, 3].tolist(),
                    "camera.quaternion": quaternion_from_rotation(mount[:3, :3]).tolist(),
                }
            },
        )
        command = [sys.executable, "-m", "flowbothd_perception.perception_node"]
        node = subprocess.Popen(
            [*command, "--ros-args", "--params-file", str(file), "--log-level", "error"],
            env=environment,
        )
        context = Context()
        try:
            # The middleware reads its profile when the first node is made, not before.
            with _Environment(environment):
                rclpy.init(context=context, domain_id=domain)
                bench = _make_bench(load, urdf, frames, context)
            return _feed(load, bench, context, psutil.Process(node.pid))
        finally:
            rclpy.try_shutdown(context=context)
            node.terminate()
            try:
                node.wait(timeout=5.0)
            except subprocess.TimeoutExpired:
                node.kill()
                node.wait()


class _Environment:
    """Sets the variables that the middleware reads when it starts, and puts them back."""

    NAMES = (
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        "ROS_AUTOMATIC_DISCOVERY_RANGE",
        "RMW_IMPLEMENTATION",
    )

    def __init__(self, values: dict[str, str]) -> None:
        self._values = values
        self._old: dict[str, str | None] = {}

    def __enter__(self) -> None:
        for name in self.NAMES:
            self._old[name] = os.environ.get(name)
            os.environ[name] = self._values[name]

    def __exit__(self, *_: object) -> None:
        for name, value in self._old.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _feed(load: Load, bench: Any, context: Any, process: psutil.Process) -> LoadFigures:
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor(context=context)
    executor.add_node(bench)
    try:
        begin = time.monotonic()
        while len(bench.delays) < 5:
            if time.monotonic() - begin > _START_TIMEOUT or not process.is_running():
                raise FlowBotError(
                    "perception_node answers nothing",
                    got=bench.said or "no diagnostics either",
                    hint="start it by hand: python -m flowbothd_perception.perception_node",
                )
            bench.publish_for(executor, 0.5)
        bench.settle(executor)
        bench.forget()
        received = int(bench.figures["frames received"])
        cpu, begin = sum(process.cpu_times()[:2]), time.monotonic()
        bench.publish_for(executor, load.seconds)
        used, passed = sum(process.cpu_times()[:2]) - cpu, time.monotonic() - begin
        bench.settle(executor)
        delays = 1e3 * np.array(bench.delays or [np.nan])
        return LoadFigures(
            sent=bench.sent,
            reached=int(bench.figures["frames received"]) - received,
            answered=len(bench.delays),
            inside_median_ms=float(bench.figures.get("latency median [ms]", "nan")),
            inside_p99_ms=float(bench.figures.get("latency p99 [ms]", "nan")),
            outside_median_ms=float(np.median(delays)),
            outside_p99_ms=float(np.percentile(delays, 99)),
            cpu_share=used / passed,
        )
    finally:
        executor.shutdown()
        bench.destroy_node()


def _make_bench(load: Load, urdf: str, frames: Sequence[TruthFrame], context: Any) -> Any:
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.node import Node
    from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
    from std_msgs.msg import Header, String

    from flowbothd_common.ros import qos
    from sim_bridge.messages_ros import CameraMessages

    class Bench(Node):
        """Publishes frames and joint states in real time, and times the answers."""

        def __init__(self) -> None:
            super().__init__("perception_bench", context=context)
            self.sent, self.said = 0, ""
            self.delays: list[float] = []
            self.figures: dict[str, str] = {}
            self._sent_at: dict[int, float] = {}
            self._description = self.create_publisher(String, "robot_description", qos.LATCHED)
            self._joints = self.create_publisher(JointState, "joint_states", qos.STATE)
            self._info = self.create_publisher(CameraInfo, "depth/camera_info", qos.IMAGE)
            if load.kind == "depth":
                self._frames = self.create_publisher(Image, "depth/image_raw", qos.FRAMES)
            else:
                self._frames = self.create_publisher(PointCloud2, "points2", qos.FRAMES)
            self.create_subscription(PointCloud2, "object_cloud", self._on_cloud, qos.FRAMES)
            self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
            self._description.publish(String(data=urdf))
            self._messages = [self._message(frame) for frame in frames]
            height, width = frames[0].depth.shape
            lens = Intrinsics(width, height)
            self._lens = CameraMessages(lens).info(Header())
            self._names = [f"panda_joint{i}" for i in range(1, 8)]

        def _message(self, frame: TruthFrame) -> Any:
            height, width = frame.depth.shape
            maker = CameraMessages(Intrinsics(width, height))
            if load.kind == "depth":
                return maker.image(Header(), np.rint(1000.0 * frame.depth).astype(np.uint16))
            return maker.cloud(Header(), frame.depth)

        def _on_cloud(self, message: PointCloud2) -> None:
            sent = self._sent_at.pop(_nanoseconds(message.header.stamp), None)
            if sent is not None:
                self.delays.append(time.monotonic() - sent)

        def _on_diagnostics(self, message: DiagnosticArray) -> None:
            for status in message.status:
                if status.name == "perception_node":
                    self.said = status.message
                    self.figures = {item.key: item.value for item in status.values}

        def forget(self) -> None:
            """Start counting anew."""
            self.sent, self.delays = 0, []
            self._sent_at.clear()

        def settle(self, executor: Any) -> None:
            """Listen for a while without sending."""
            end = time.monotonic() + 1.2
            while time.monotonic() < end:
                executor.spin_once(timeout_sec=0.05)

        def publish_for(self, executor: Any, seconds: float) -> None:
            """Publish for so long; what is late is sent late, not left out."""
            begin = time.monotonic()
            frame = joints = 0
            while True:
                now = time.monotonic() - begin
                if now >= seconds:
                    return
                due_frame, due_joints = frame / load.rate, joints / load.joint_rate
                if now >= due_joints:
                    self._send_joints(frame)
                    joints += 1
                elif now >= due_frame:
                    self._send_frame(frame)
                    frame += 1
                else:
                    executor.spin_once(timeout_sec=max(0.0, min(due_frame, due_joints) - now))

        def _send_joints(self, frame: int) -> None:
            shown = frames[(frame // 30) % len(frames)]
            message = JointState(name=self._names, position=shown.joint_positions.tolist())
            message.header.stamp = self.get_clock().now().to_msg()
            self._joints.publish(message)

        def _send_frame(self, frame: int) -> None:
            message = self._messages[(frame // 30) % len(frames)]
            message.header.stamp = self._lens.header.stamp = self.get_clock().now().to_msg()
            self._sent_at[_nanoseconds(message.header.stamp)] = time.monotonic()
            self._info.publish(self._lens)
            self._frames.publish(message)
            self.sent += 1

    return Bench()


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
