"""From camera messages to arrays."""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image

from flowbothd_common.errors import InvalidCloudError
from flowbothd_perception.depth import Lens

_TYPES = {"16UC1": np.uint16, "mono16": np.uint16, "32FC1": np.float32}


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
    if message.is_bigendian != (sys.byteorder == "big"):
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
