"""Takes captures from a running camera and robot, whenever the arm stands still somewhere new."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, JointState

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.ros import qos
from flowbothd_common.ros.conversions import to_seconds
from flowbothd_perception.calibration.captures import Capture
from flowbothd_perception.calibration.stillness import Stillness
from flowbothd_perception.images_ros import from_camera_info, from_depth_image
from flowbothd_perception.params import CameraParams


class CaptureNode(Node):
    """Listens to camera and joints.

    Args:
        camera: Names of its topics.
        picture_topic: Infrared image in the depth image's geometry; empty = none is wanted.
        on_capture: Called with every capture.
    """

    def __init__(
        self,
        camera: CameraParams,
        picture_topic: str,
        on_capture: Callable[[Capture], None],
        **kwargs: Any,
    ) -> None:
        super().__init__("calibration_capture", **kwargs)
        self._on_capture, self._wants_picture = on_capture, bool(picture_topic)
        self._stillness = Stillness()
        self._names: tuple[str, ...] = ()
        self._info: CameraInfo | None = None
        self._picture: Image | None = None
        self.heard: set[str] = set()
        profile = qos.FRAMES_BEST_EFFORT if camera.best_effort else qos.FRAMES
        listen = self.create_subscription
        listen(JointState, "joint_states", self._on_joints, qos.STATE_NEWEST)
        listen(CameraInfo, camera.info_topic, self._on_info, profile)
        listen(Image, camera.depth_topic, self._on_depth, profile)
        if picture_topic:
            listen(Image, picture_topic, self._on_picture, profile)

    def _on_joints(self, message: JointState) -> None:
        self.heard.add("joint_states")
        self._names = tuple(message.name)
        positions = np.array(message.position, dtype=float)
        self._stillness.add(to_seconds(message.header.stamp), positions)

    def _on_info(self, message: CameraInfo) -> None:
        self.heard.add("camera_info")
        self._info = message

    def _on_picture(self, message: Image) -> None:
        self.heard.add("picture")
        self._picture = message

    def _on_depth(self, message: Image) -> None:
        self.heard.add("depth")
        if self._info is None or (self._wants_picture and self._picture is None):
            return
        positions = self._stillness.ready(to_seconds(message.header.stamp))
        if positions is None:
            return
        picture = None if self._picture is None else brightness(self._picture)
        self._stillness.taken(positions)
        self._on_capture(
            Capture(
                self._names,
                positions,
                from_camera_info(self._info),
                np.array(from_depth_image(message)),
                picture,
            )
        )


def brightness(message: Image) -> NDArray[np.uint8]:
    """(H, W) uint8 of a mono8, mono16 or colour image, stretched to the full range.

    Raises:
        InvalidCloudError: an encoding that is not understood, or missing bytes.
    """
    kinds = {"mono8": ("u1", 1), "mono16": ("u2", 1), "16UC1": ("u2", 1)}
    kinds |= dict.fromkeys(("rgb8", "bgr8"), ("u1", 3))
    kinds |= dict.fromkeys(("rgba8", "bgra8"), ("u1", 4))
    if message.encoding not in kinds:
        raise InvalidCloudError(
            "picture encoding", got=message.encoding or "none", allowed=", ".join(kinds)
        )
    kind, channels = kinds[message.encoding]
    item = np.dtype((">" if message.is_bigendian else "<") + kind)
    height, width = message.height, message.width
    step = message.step or width * channels * item.itemsize
    if step < width * channels * item.itemsize or len(message.data) < height * step:
        raise InvalidCloudError(
            "picture is shorter than its sizes say",
            got=f"{len(message.data)} bytes, step {step}",
            allowed=f"{height} rows of at least {width * channels * item.itemsize} bytes",
        )
    values = np.ndarray(
        (height, width, channels),
        item,
        np.frombuffer(message.data, np.uint8),
        0,
        (step, channels * item.itemsize, item.itemsize),
    )
    grey = values[..., :3].mean(axis=2)
    # Infrared images use little of their range.
    top = float(np.percentile(grey, 99.5)) if grey.size else 0.0
    return np.asarray(np.clip(grey * (255.0 / max(top, 1.0)), 0, 255), dtype=np.uint8)
