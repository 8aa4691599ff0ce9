"""Publishers of perception: the object cloud, and on demand the class of every pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from flowbothd_common.ros import clouds, qos
from flowbothd_common.types import Array, Cloud
from flowbothd_perception.crop import to_base
from flowbothd_perception.frame import Frame
from flowbothd_perception.pipeline import PerceptionResult, Verdict


class CloudOutputs:
    """Publishers of the clouds; all in base, with the stamp of the frame they come from.

    `~/debug/robot` and `~/debug/outliers` hold the points that were removed; `~/organised` has the
    shape of the frame, with NaN wherever the object is not. The three cost time, and are made only
    while somebody listens.
    """

    def __init__(self, node: Node, base_frame: str) -> None:
        self._base_frame = base_frame
        make = node.create_publisher
        # With one message kept, a recorder that is a moment late would miss what was decided upon.
        self._object = make(PointCloud2, "object_cloud", qos.FRAMES)
        self._organised = make(PointCloud2, "~/organised", qos.IMAGE)
        self._removed = {
            Verdict.ROBOT: make(PointCloud2, "~/debug/robot", qos.IMAGE),
            Verdict.OUTLIER: make(PointCloud2, "~/debug/outliers", qos.IMAGE),
        }

    @property
    def whole(self) -> bool:
        """True while somebody subscribes to a topic that needs every pixel."""
        return any(
            publisher.get_subscription_count()
            for publisher in (self._organised, *self._removed.values())
        )

    def publish(
        self, source: Header, frame: Frame, T_base_camera: Array, result: PerceptionResult
    ) -> None:
        """Publish the result of one frame."""
        header = Header(stamp=source.stamp, frame_id=self._base_frame)
        self._object.publish(clouds.to_cloud_message(header, result.points, clouds.XYZ))
        if result.verdicts is None:
            return
        for verdict, publisher in self._removed.items():
            if publisher.get_subscription_count():
                points = _points(frame, T_base_camera, result.verdicts, verdict)[1]
                publisher.publish(clouds.to_cloud_message(header, points, clouds.XYZ))
        if self._organised.get_subscription_count():
            values = organised(frame, T_base_camera, result.verdicts)
            self._organised.publish(clouds.to_cloud_message(header, values, clouds.XYZ))


def organised(frame: Frame, T_base_camera: Array, verdicts: NDArray[np.uint8]) -> Cloud:
    """(H, W, 3) points of the object in base, NaN elsewhere."""
    pixels, points = _points(frame, T_base_camera, verdicts, Verdict.OBJECT)
    values = np.full((*frame.shape, 3), np.nan, dtype=np.float32)
    values.reshape(-1, 3)[pixels] = points
    return values


def _points(
    frame: Frame, T_base_camera: Array, verdicts: NDArray[np.uint8], verdict: Verdict
) -> tuple[NDArray[np.intp], Cloud]:
    pixels = np.flatnonzero(verdicts == verdict)
    return pixels, to_base(T_base_camera, frame.points(pixels))
