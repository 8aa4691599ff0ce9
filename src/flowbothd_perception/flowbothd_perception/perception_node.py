"""From camera and joint states to `object_cloud`: cropped, without the robot, sampled, in base."""

from __future__ import annotations

import sys
import time
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import String

from flowbothd_common.errors import InvalidMessageError
from flowbothd_common.ros import diagnostics, qos, received
from flowbothd_common.ros.conversions import to_seconds
from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.liveness import Silence
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from flowbothd_common.types import Array
from flowbothd_perception.images_ros import FrameReader
from flowbothd_perception.joint_buffer import JointBuffer
from flowbothd_perception.outputs_ros import CloudOutputs
from flowbothd_perception.params import PerceptionNodeParams
from flowbothd_perception.pipeline import PerceptionPipeline
from flowbothd_perception.raw_cloud_ros import AnyCloud, read_cloud
from flowbothd_perception.statistics import FrameStatistics
from flowbothd_perception.waiting import WaitingFrames


class PerceptionNode(Node):
    """Feeds the pipeline with frames and the joint positions of their time."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("perception_node", **kwargs)
        self._params = params = declare(self, PerceptionNodeParams)
        self._T_base_camera = params.camera.T_base_camera
        self._pipeline: PerceptionPipeline | None = None
        self._joints: JointBuffer | None = None
        self._description = ""
        self._reader = FrameReader(params.camera.frame, params.max_depth)
        self._waiting: WaitingFrames[Image | AnyCloud] = WaitingFrames(params.joint_wait)
        self._statistics = FrameStatistics()
        self._guard = Guard(self, refusals=(KeyError, ValueError))
        self._remark = ""
        self._status = diagnostics.NodeStatus(self, self._guard)
        self._heard_joints = Silence(params.joint_timeout)
        self._heard_camera = Silence(params.image_timeout)
        self._outputs = CloudOutputs(self, params.base_frame)
        self._create_inputs()
        self._guard.every(0.1, self._on_timer)

    def _create_inputs(self) -> None:
        camera = self._params.camera
        profile = qos.FRAMES_BEST_EFFORT if camera.best_effort else qos.FRAMES

        listen = self._guard.subscribe
        listen(String, "robot_description", self._on_description, qos.LATCHED)
        listen(JointState, "joint_states", self._on_joints, qos.STATE_NEWEST)
        listen(CameraInfo, camera.info_topic, self._on_info, profile)
        if self._params.input == "depth":
            self._camera_topics: tuple[str, ...] = (camera.depth_topic, camera.info_topic)
            listen(Image, camera.depth_topic, self._on_frame, profile)
        else:
            # Clouds do without the intrinsics, but a flattened one gets its shape back from them.
            self._camera_topics = (camera.cloud_topic,)
            listen(PointCloud2, camera.cloud_topic, self._on_cloud, profile, raw=True)

    def destroy_node(self) -> None:
        """Stop the heartbeat before its publisher goes."""
        self._status.close()
        super().destroy_node()

    def _on_description(self, message: String) -> None:
        if message.data == self._description:
            return
        params = self._params
        self._description, self._pipeline, self._joints = "", None, None
        self._pipeline = pipeline = PerceptionPipeline(params, message.data)
        self._joints = JointBuffer(
            pipeline.joint_names,
            params.max_gap,
            params.stationary_threshold,
            params.max_extrapolation,
        )
        self._description = message.data

    def _on_joints(self, message: JointState) -> None:
        if self._joints is None:
            return
        names = self._joints.names
        first = not self._heard_joints.ever("joint_states")
        values = received.joint_state(message, names, expected=first)
        if values is None:
            return
        stamp = to_seconds(message.header.stamp)
        if stamp <= 0.0:
            raise InvalidMessageError(
                "joint state without a stamp", hint="frames are matched with joint states by time"
            )
        self._joints.add(stamp, names, values[0].tolist())
        self._heard_joints.heard("joint_states")
        self._process_waiting()

    def _on_info(self, message: CameraInfo) -> None:
        self._heard_camera.heard(self._params.camera.info_topic)
        self._reader.learn(message)

    def _on_cloud(self, raw: bytes | PointCloud2) -> None:
        self._on_frame(read_cloud(raw))

    def _on_frame(self, message: Image | AnyCloud) -> None:
        now = time.monotonic()
        self._heard_camera.heard(self._camera_topics[0])
        self._statistics.arrived(now)
        for old in self._waiting.add(to_seconds(message.header.stamp), message, now):
            stamp = to_seconds(old.header.stamp)
            why = self._joints.at(stamp)[1] if self._joints is not None else "no robot yet"
            self._drop(f"newer ones came while it waited: {why}")
        self._process_waiting()

    def _process_waiting(self) -> None:
        """Process frames that the joint states have caught up with."""
        if self._joints is None:
            return
        for message, arrived, positions, why in self._waiting.take(self._joints, time.monotonic()):
            if positions is None:
                self._drop(why)
            else:
                self._guard.take("frame", self._process, (message, arrived, positions))

    def _drop(self, why: str) -> None:
        self._remark = f"frame dropped: {why}"
        self._statistics.dropped()

    def _process(self, waited: tuple[Image | AnyCloud, float, Array]) -> None:
        message, arrived, positions = waited
        if self._pipeline is None:
            return
        stamp = message.header.stamp
        frame = self._reader.read(message)
        seed = (self._params.seed, max(stamp.sec, 0), stamp.nanosec)
        result = self._pipeline.process(
            frame, self._T_base_camera, positions, seed, whole=self._outputs.whole
        )
        self._outputs.publish(message.header, frame, self._T_base_camera, result)
        self._remark = result.message
        self._statistics.published(result, time.monotonic() - arrived)

    def _on_timer(self) -> None:
        # A frame whose joint states do not come is not kept for ever.
        self._process_waiting()
        self._report()

    def _missing(self) -> list[str]:
        missing = [] if self._description else ["robot_description (motion_node)"]
        missing += self._heard_camera.silent(self._camera_topics)
        if self._description:
            missing += self._heard_joints.silent(["joint_states"])
        return missing

    def _report(self) -> None:
        figures = self._statistics.figures(time.monotonic())
        missing = self._missing()
        wrong = [f"missing: {', '.join(missing)}"] if missing else []
        wrong += self._guard.troubles()
        if wrong:
            self._status.report(diagnostics.ERROR, "; ".join(wrong), figures)
        elif self._remark:
            self._status.report(diagnostics.WARN, self._remark, figures)
        else:
            self._status.report(diagnostics.OK, "publishing object_cloud", figures)


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(PerceptionNode, args)


if __name__ == "__main__":
    sys.exit(main())
