"""Messages of the bridge's camera: images, camera info, organised clouds."""

from __future__ import annotations

import array

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import Header

from sim_bridge.camera import Intrinsics


class CameraMessages:
    """Builds a camera's messages, reusing their payloads: a new array would cost milliseconds."""

    def __init__(self, lens: Intrinsics) -> None:
        self._lens = lens
        self._directions = lens.directions()
        pixels = lens.width * lens.height
        self._depth = array.array("B", bytes(2 * pixels))
        # Like the Azure Kinect's driver: x, y, z in 16 bytes.
        self._cloud = array.array("B", bytes(16 * pixels))

    def image(self, header: Header, millimetres: NDArray[np.uint16]) -> Image:
        """16UC1 depth image [mm], 0 = invalid."""
        height, width = millimetres.shape
        np.frombuffer(self._depth, np.uint16).reshape(height, width)[:] = millimetres
        return Image(
            header=header,
            height=height,
            width=width,
            encoding="16UC1",
            is_bigendian=0,
            step=2 * width,
            data=self._depth,
        )

    def info(self, header: Header) -> CameraInfo:
        """Intrinsics; the distortion is zero."""
        lens = self._lens
        fx, fy, cx, cy = lens.fx, lens.fy, lens.cx, lens.cy
        return CameraInfo(
            header=header,
            height=lens.height,
            width=lens.width,
            distortion_model="rational_polynomial",
            d=[0.0] * 8,
            k=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        )

    def cloud(self, header: Header, depth: NDArray[np.float32]) -> PointCloud2:
        """Organised cloud in the optical frame [m]; NaN where nothing was measured."""
        height, width = depth.shape
        values = np.frombuffer(self._cloud, np.float32).reshape(height, width, 4)
        np.multiply(
            self._directions, np.where(depth > 0, depth, np.nan)[..., None], out=values[..., :3]
        )
        fields = [
            PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
            for i, name in enumerate("xyz")
        ]
        return PointCloud2(
            header=header,
            height=height,
            width=width,
            fields=fields,
            is_bigendian=False,
            point_step=16,
            row_step=16 * width,
            data=self._cloud,
            is_dense=False,
        )
