"""Quality of service between rclpy and recordings."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

from flowbothd_rosbag.metadata import QosProfile, Topic

_SECOND = 10**9


def _duration(value: Duration) -> dict[str, int]:
    return {"sec": value.nanoseconds // _SECOND, "nsec": value.nanoseconds % _SECOND}


def to_words(profile: QoSProfile) -> QosProfile:
    """The profile as rosbag2 writes it."""
    return {
        "history": HistoryPolicy(profile.history).name.lower(),
        "depth": int(profile.depth),
        "reliability": ReliabilityPolicy(profile.reliability).name.lower(),
        "durability": DurabilityPolicy(profile.durability).name.lower(),
        "deadline": _duration(profile.deadline),
        "lifespan": _duration(profile.lifespan),
        "liveliness": LivelinessPolicy(profile.liveliness).name.lower(),
        "liveliness_lease_duration": _duration(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": bool(profile.avoid_ros_namespace_conventions),
    }


def listening(offers: Sequence[QoSProfile], depth: int) -> QoSProfile:
    """A profile that every one of the offers satisfies, with as much queue as asked for.

    Args:
        offers: Of the publishers, at least one.
        depth: Messages that may wait for the recorder.
    """
    reliable = all(o.reliability == ReliabilityPolicy.RELIABLE for o in offers)
    latched = all(o.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in offers)
    return _profile(reliable=reliable, latched=latched, depth=depth)


def publishing(topic: Topic, depth: int = 100) -> QoSProfile:
    """What a replay offers on a topic: what was offered when it was recorded."""
    return _profile(reliable=topic.reliable, latched=topic.latched, depth=depth)


def _profile(*, reliable: bool, latched: bool, depth: int) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
