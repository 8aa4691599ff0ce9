"""A thinned cloud of a depth image, in base."""

from __future__ import annotations

from typing import Any

import numpy as np

from flowbothd_common.transforms import rotation_from_quaternion
from flowbothd_common.types import Array, Cloud

STRIDE = 6
"""Every how many-th pixel is shown, in both directions."""

_RANGE = 2.5
"""Points farther than this are left out [m]."""


def camera_pose(parameters: dict[str, Any]) -> Array | None:
    """(4, 4) T_base_camera from the parameters of perception; None if they do not say it."""
    position, quaternion = parameters.get("camera.position"), parameters.get("camera.quaternion")
    if not position or not quaternion:
        return None
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_quaternion(tuple(quaternion))
    pose[:3, 3] = position
    return pose


def thinned_cloud(image: Any, info: Any, T_base_camera: Array) -> Cloud:
    """(N, 3) points in base of every `STRIDE`-th pixel; lens distortion is left alone.

    Args:
        image: sensor_msgs/Image, 16UC1 in millimetres or 32FC1 in metres.
        info: sensor_msgs/CameraInfo.
        T_base_camera: (4, 4).
    """
    kind = np.dtype("<u2") if image.encoding == "16UC1" else np.dtype("<f4")
    rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)
    values = rows[:, : image.width * kind.itemsize].view(kind)[::STRIDE, ::STRIDE]
    depth = values.astype(np.float32) * (0.001 if kind.itemsize == 2 else 1.0)
    v, u = np.mgrid[0 : image.height : STRIDE, 0 : image.width : STRIDE]
    fx, fy, cx, cy = info.k[0], info.k[4], info.k[2], info.k[5]
    seen = np.isfinite(depth) & (depth > 0) & (depth < _RANGE)
    z = depth[seen]
    points = np.stack([(u[seen] - cx) / fx * z, (v[seen] - cy) / fy * z, z], axis=1)
    return (points @ T_base_camera[:3, :3].T + T_base_camera[:3, 3]).astype(np.float32)
