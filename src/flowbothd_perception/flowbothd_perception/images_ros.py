"""From camera messages to frames."""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image

from flowbothd_common.errors import FrameUnavailableError, InvalidCloudError
from flowbothd_common.ros import clouds
from flowbothd_perception.depth import Lens, ray_table
from flowbothd_perception.frame import CloudFrame, DepthFrame, Frame, Optics
from flowbothd_perception.raw_cloud_ros import AnyCloud

_TYPES = {"16UC1": np.uint16, "mono16": np.uint16, "32FC1": np.float32}


class FrameReader:
    """Turns messages of one camera into frames; remembers its lens.

    Args:
        frame_id: That messages must carry; empty = any.
        max_depth: Farther measurements do not count [m].
    """

    def __init__(self, frame_id: str = "", max_depth: float = np.inf) -> None:
        self._frame_id, self._max_depth = frame_id, max_depth
        self._lens: Lens | None = None
        self._optics: Optics | None = None

    def learn(self, message: CameraInfo) -> None:
        """Take in the intrinsics; costs something only when they change.

        Raises:
            InvalidCloudError: not calibrated, or a distortion model that is not supported.
        """
        lens = from_camera_info(message)
        if lens != self._lens:
            self._lens, self._optics = lens, Optics(ray_table(lens))

    def read(self, message: Image | AnyCloud) -> Frame:
        """The frame of a message.

        Raises:
            FrameUnavailableError: another frame id, or a depth image before its intrinsics.
            InvalidCloudError: an encoding or layout that is not understood, or missing bytes.
        """
        if self._frame_id and message.header.frame_id != self._frame_id:
            raise FrameUnavailableError(
                "frame id of the camera",
                got=message.header.frame_id or "none",
                allowed=self._frame_id,
                hint="camera.frame names the optical frame that camera.position is about",
            )
        if isinstance(message, AnyCloud):
            return CloudFrame(self._shaped(message), self._max_depth)
        if self._optics is None:
            raise FrameUnavailableError("no intrinsics of the depth camera yet")
        return DepthFrame(from_depth_image(message), self._optics, self._max_depth)

    def _shaped(self, message: AnyCloud) -> NDArray[np.float32]:
        """(H, W, 3); the intrinsics' size restores an organised cloud that a driver flattened."""
        values = clouds.from_cloud_message(message, clouds.XYZ)
        lens = self._lens
        if values.shape[0] == 1 and lens and values.shape[1] == lens.width * lens.height:
            return values.reshape(lens.height, lens.width, 3)
        return values


def from_depth_image(message: Image) -> NDArray[np.generic]:
    """(H, W) uint16 [mm] or float32 [m] of a depth image, a view of the message's bytes.

    Raises:
        InvalidCloudError: an unknown encoding, or fewer bytes than the sizes promise.
    """
    if message.encoding not in _TYPES:
        raise InvalidCloudError(
            "depth image encoding", got=message.encoding or "none", allowed=", ".join(_TYPES)
        )
    kind = np.dtype(_TYPES[message.encoding])
    if bool(message.is_bigendian) != (sys.byteorder == "big"):
        kind = kind.newbyteorder()
    height, width = message.height, message.width
    step = message.step or width * kind.itemsize
    if step < width * kind.itemsize or len(message.data) < height * step:
        raise InvalidCloudError(
            "depth image is shorter than its sizes say",
            got=f"{len(message.data)} bytes, step {step}",
            allowed=f"{height} rows of at least {width * kind.itemsize} bytes",
        )
    view = np.ndarray(
        (height, width), kind, np.frombuffer(message.data, np.uint8), 0, (step, kind.itemsize)
    )
    return view.astype(kind.newbyteorder("=")) if not kind.isnative else view


def from_camera_info(message: CameraInfo) -> Lens:
    """The lens.

    Raises:
        InvalidCloudError: not calibrated, or a distortion model that is not supported.
    """
    return Lens(
        message.width,
        message.height,
        tuple(float(value) for value in message.k),
        tuple(float(value) for value in message.d),
    )
