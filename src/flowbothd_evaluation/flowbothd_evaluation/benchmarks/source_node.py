"""A robot's worth of messages, numbered: what `flowbothd bench record` records.

    python -m flowbothd_evaluation.benchmarks.source_node --seconds 60 [--clouds]

Every message carries its number as the seconds of its stamp, so that a recording can be searched
for gaps.
"""

from __future__ import annotations

import argparse
import array
import json
import sys
import time
from typing import Any

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2, PointField
from std_msgs.msg import Header

from flowbothd_common.malloc_tuning import keep_freed_memory, spare_what_stays
from flowbothd_common.parent_watch import watch_parent
from flowbothd_common.ros import qos

WIDTH, HEIGHT = 640, 576
FRAME_RATE, JOINT_RATE = 30, 100
_PICTURES = 8
"""Different frames that take turns; compression must not see the same twice in a row."""


def _depths() -> list[NDArray[np.uint16]]:
    """Smooth walls with the noise of a time-of-flight camera [mm]."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    result = []
    for i in range(_PICTURES):
        wall = 900 + 300 * np.sin((u + 10 * i) / 90) + 200 * v / HEIGHT
        noisy = wall + rng.normal(0, 2.0, wall.shape)
        noisy[rng.random(wall.shape) < 0.05] = 0
        result.append(noisy.astype(np.uint16))
    return result


def _cloud(depth: NDArray[np.uint16]) -> PointCloud2:
    """Organised cloud as the Azure Kinect driver publishes it: 16 bytes a point, NaN = invalid."""
    z = np.where(depth > 0, depth / np.float32(1000), np.float32(np.nan)).astype(np.float32)
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    values = np.zeros((HEIGHT, WIDTH, 4), np.float32)
    values[..., 0], values[..., 1], values[..., 2] = (u - 320) / 504 * z, (v - 288) / 504 * z, z
    fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate("xyz")
    ]
    return PointCloud2(
        height=HEIGHT,
        width=WIDTH,
        fields=fields,
        point_step=16,
        row_step=16 * WIDTH,
        data=array.array("B", values.tobytes()),
    )


class Source:
    """Publishes at fixed rates against the steady clock.

    Args:
        node: Gets the publishers.
        clouds: Full clouds too.
    """

    def __init__(self, node: Node, *, clouds: bool) -> None:
        depths = _depths()
        images = [
            Image(
                height=HEIGHT,
                width=WIDTH,
                encoding="16UC1",
                step=2 * WIDTH,
                data=array.array("B", depth.tobytes()),
            )
            for depth in depths
        ]
        infos = [CameraInfo(height=HEIGHT, width=WIDTH)]
        joints = [JointState(name=[f"panda_joint{i}" for i in range(1, 8)], position=[0.0] * 7)]
        self._outputs: list[tuple[Publisher, int, list[Any]]] = []
        for topic, kind, rate, messages, profile in (
            ("depth/image_raw", Image, FRAME_RATE, images, qos.IMAGE),
            ("depth/camera_info", CameraInfo, FRAME_RATE, infos, qos.IMAGE),
            ("joint_states", JointState, JOINT_RATE, joints, qos.STATE),
        ):
            publisher = node.create_publisher(kind, topic, profile)
            self._outputs.append((publisher, rate, messages))
        if clouds:
            made = [_cloud(depth) for depth in depths]
            publisher = node.create_publisher(PointCloud2, "points2", qos.IMAGE)
            self._outputs.append((publisher, FRAME_RATE, made))

    def wait_for_listener(self, timeout: float) -> bool:
        """Whether every topic has a subscriber within the time."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if all(publisher.get_subscription_count() for publisher, _, _ in self._outputs):
                return True
            time.sleep(0.05)
        return False

    def run(self, seconds: float) -> dict[str, int]:
        """Publish; topic -> how many."""
        schedule = sorted(
            (i / rate, number, i)
            for number, (_, rate, _) in enumerate(self._outputs)
            for i in range(round(seconds * rate))
        )
        begin = time.monotonic()
        for due, number, i in schedule:
            publisher, _, messages = self._outputs[number]
            message = messages[i % len(messages)]
            message.header = Header(frame_id="bench")
            message.header.stamp.sec = i
            time.sleep(max(due - (time.monotonic() - begin), 0.0))
            publisher.publish(message)
        for publisher, _, _ in self._outputs:
            publisher.wait_for_all_acked(Duration(seconds=10.0))
        return {publisher.topic_name: round(seconds * rate) for publisher, rate, _ in self._outputs}


def main() -> int:
    """Publish once somebody listens to everything; print how much."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--clouds", action="store_true")
    arguments = parser.parse_args()
    watch_parent()
    keep_freed_memory()
    rclpy.init()
    node = Node("source")
    try:
        source = Source(node, clouds=arguments.clouds)
        if not source.wait_for_listener(60.0):
            sys.stderr.write("nobody listens\n")
            return 2
        spare_what_stays()
        began = time.monotonic()
        published = source.run(arguments.seconds)
        took = time.monotonic() - began
        sys.stdout.write(json.dumps({"published": published, "seconds": took}) + "\n")
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
