"""What is recorded, and where to."""

from __future__ import annotations

import re
from dataclasses import dataclass

from flowbothd_common.parameters import parameter

PROFILES = ("light", "all", "debug")

_PICTURES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_CLOUD = "sensor_msgs/msg/PointCloud2"


@dataclass(frozen=True)
class RecorderParams:
    """Parameters of the recorder node."""

    out: str = parameter("", "new folder of the recording; empty = named after the time")
    profile: str = parameter(
        "light",
        "light: everything that a replay needs, so depth images but no camera clouds and no colour;"
        " all: everything but debug topics; debug: everything",
        choices=PROFILES,
    )
    exclude: str = parameter("", "topics that match this regular expression are left out")
    queue_mb: float = parameter(
        512.0,
        "memory for messages that wait to be written [MB]; beyond it they are dropped and counted",
        minimum=1.0,
        maximum=100000.0,
    )
    discovery_period: float = parameter(
        0.25, "how often new topics are looked for [s]", minimum=0.05, maximum=10.0
    )


def wanted(name: str, kind: str, params: RecorderParams) -> bool:
    """Whether a topic belongs to the recording.

    Args:
        name: With its leading slash.
        kind: Type, such as ``sensor_msgs/msg/Image``.
        params: What is recorded.
    """
    if params.exclude and re.search(params.exclude, name):
        return False
    if params.profile == "debug":
        return True
    if "/debug/" in name:
        return False
    if params.profile == "all":
        return True
    if kind == _CLOUD:
        return name.endswith("/object_cloud")
    return kind not in _PICTURES or name.endswith("/depth/image_raw")
