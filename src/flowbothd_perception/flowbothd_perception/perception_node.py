"""From camera and joint states to `object_cloud`: cropped, without the robot, sampled, in base."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import Header, String

from flowbothd_common.errors import FlowBotError, FrameUnavailableError
from flowbothd_common.ros import clouds, diagnostics, qos
from flowbothd_common.ros.conversions import to_seconds
from flowbothd_common.ros.liveness import Silence
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from flowbothd_common.types import Cloud
from flowbothd_perception.cloud import valid_points
from flowbothd_perception.depth import Lens, depth_in_metres, points_from_depth, ray_table
from flowbothd_perception.images_ros import from_camera_info, from_depth_image
from flowbothd_perception.joint_buffer import JointBuffer
from flowbothd_perception.params import PerceptionNodeParams
from flowbothd_perception.pipeline import PerceptionPipeline, PerceptionResult

_LONGEST_WAIT = 1.0
"""Difference of stamps [s] after which a frame no longer waits for its joint states."""


class PerceptionNode(Node):
    """Feeds the pipeline with frames and the joint positions of their time."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("perception_node", **kwargs)
        self._params = declare(self, PerceptionNodeParams)
        self._T_base_camera = self._params.camera.T_base_camera
        self._pipeline: PerceptionPipeline | None = None
        self._joints: JointBuffer | None = None
        self._description = ""
        self._lens: Lens | None = None
        self._rays: NDArray[np.float32] | None = None
        self._frames: list[Image | PointCloud2] = []
        self._trouble: dict[str, str] = {}
        self._figures: dict[str, object] = {}
        self._remark = ""
        self._status = diagnostics.NodeStatus(self)
        self._heard_joints = Silence(self._params.joint_timeout)
        self._heard_camera = Silence(self._params.image_timeout)
        self._cloud = self.create_publisher(PointCloud2, "object_cloud", qos.IMAGE)
        self._create_inputs()
        # The steady clock runs on when the simulation, and with it the node clock, is gone.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(0.1, self._report, clock=steady)

    def _create_inputs(self) -> None:
        listen = self.create_subscription
        listen(String, "robot_description", self._on_description, qos.LATCHED)
        listen(JointState, "joint_states", self._on_joints, qos.STATE)
        if self._params.input == "depth":
            self._camera_topics: tuple[str, ...] = ("depth/image_raw", "depth/camera_info")
            listen(Image, "depth/image_raw", self._on_frame, qos.IMAGE)
            listen(CameraInfo, "depth/camera_info", self._on_info, qos.IMAGE)
        else:
            self._camera_topics = ("points2",)
            listen(PointCloud2, "points2", self._on_frame, qos.IMAGE)

    def destroy_node(self) -> None:
        """Stop the heartbeat before its publisher goes."""
        self._status.close()
        super().destroy_node()

    def _on_description(self, message: String) -> None:
        if message.data == self._description:
            return
        self._description = message.data
        try:
            self._pipeline = PerceptionPipeline(self._params, message.data)
            self._joints = JointBuffer(
                self._pipeline.joint_names, self._params.joint_gap, self._params.joint_still
            )
            self._trouble.pop("robot_description", None)
        except FlowBotError as error:
            self._pipeline = None
            self._trouble["robot_description"] = str(error)

    def _on_joints(self, message: JointState) -> None:
        if self._joints is None:
            return
        self._heard_joints.heard("joint_states")
        try:
            stamp = to_seconds(message.header.stamp)
            self._joints.add(stamp, message.name, message.position)
        except (KeyError, IndexError) as error:
            self._trouble["joint_states"] = f"joint_states: {error.args[0]}"
            return
        self._trouble.pop("joint_states", None)
        self._process_waiting()

    def _on_info(self, message: CameraInfo) -> None:
        self._heard_camera.heard("depth/camera_info")
        try:
            lens = from_camera_info(message)
            if lens != self._lens:
                self._lens, self._rays = lens, ray_table(lens)
            self._trouble.pop("lens", None)
        except FlowBotError as error:
            self._trouble["lens"] = str(error)

    def _on_frame(self, message: Image | PointCloud2) -> None:
        """Keep the frame that waits for its joint states, and the newest behind it."""
        self._heard_camera.heard(self._camera_topics[0])
        ahead = [
            to_seconds(message.header.stamp) - to_seconds(f.header.stamp) for f in self._frames
        ]
        # Time was reset, or the joint states stopped long ago: what waits, waits in vain.
        hopeless = bool(ahead) and not 0 <= ahead[0] <= _LONGEST_WAIT
        self._frames = [message] if hopeless else [*self._frames[:1], message]
        self._process_waiting()

    def _process_waiting(self) -> None:
        """Process waiting frames that the joint states have caught up with."""
        while self._frames and self._joints is not None:
            stamp = to_seconds(self._frames[0].header.stamp)
            if not self._joints.covers(stamp):
                return
            self._process(self._frames.pop(0), stamp)

    def _process(self, message: Image | PointCloud2, stamp: float) -> None:
        if self._pipeline is None or self._joints is None:
            return
        positions, why = self._joints.at(stamp)
        if positions is None:
            self._remark = f"frame dropped: {why}"
            return
        try:
            points = self._measured(message)
            seed = (self._params.seed, message.header.stamp.sec, message.header.stamp.nanosec)
            result = self._pipeline.process(points, self._T_base_camera, positions, seed)
        except FlowBotError as error:
            self._remark = f"frame dropped: {error}"
            return
        self._publish(message.header, result)

    def _measured(self, message: Image | PointCloud2) -> Cloud:
        wanted = self._params.camera.frame
        if wanted and message.header.frame_id != wanted:
            raise FrameUnavailableError(
                "frame id of the camera", got=message.header.frame_id, allowed=wanted
            )
        if isinstance(message, PointCloud2):
            values = clouds.from_cloud_message(message, clouds.XYZ)
            return valid_points(values, self._params.max_depth)
        if self._rays is None:
            raise FrameUnavailableError("no depth/camera_info yet")
        depth = depth_in_metres(from_depth_image(message))
        return points_from_depth(depth, self._rays, self._params.max_depth)

    def _publish(self, source: Header, result: PerceptionResult) -> None:
        header = Header(stamp=source.stamp, frame_id=self._params.base_frame)
        self._cloud.publish(clouds.to_cloud_message(header, result.points, clouds.XYZ))
        self._remark = result.message
        self._figures = {f"points {stage}": count for stage, count in result.counts.items()}
        for stage, seconds in result.seconds.items():
            self._figures[f"{stage} [ms]"] = f"{1e3 * seconds:.1f}"

    def _missing(self) -> list[str]:
        missing = [] if self._description else ["robot_description (motion_node)"]
        missing += self._heard_camera.silent(self._camera_topics)
        if self._description:
            missing += self._heard_joints.silent(["joint_states"])
        return missing

    def _report(self) -> None:
        missing = self._missing()
        if missing:
            self._status.report(diagnostics.ERROR, f"missing: {', '.join(missing)}")
        elif self._trouble:
            self._status.report(diagnostics.ERROR, "; ".join(self._trouble.values()))
        elif self._remark:
            self._status.report(diagnostics.WARN, self._remark, self._figures)
        else:
            self._status.report(diagnostics.OK, "publishing object_cloud", self._figures)


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop."""
    return run_node(PerceptionNode, args)


if __name__ == "__main__":
    sys.exit(main())
