"""The perception node once more on recorded frames, without timing: every frame is processed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter

from flowbothd_bringup.bags.metadata import BagError
from flowbothd_bringup.bags.reader import Bag, Span
from flowbothd_bringup.environment import own_domain
from flowbothd_bringup.replay.story import Stamp, Story, decoded, key
from flowbothd_common.ros import clouds
from flowbothd_common.types import Cloud
from flowbothd_perception.perception_node import PerceptionNode

NODE = "perception_node"

_ORDER = {"String": 0, "CameraInfo": 1, "JointState": 2}
"""Of messages with the same stamp: what a frame needs comes before it."""

_AHEAD = 0.5
"""Seconds of receive time within which messages are put into the order of their stamps [s]."""


class _Captured:
    """Stands where the node's publishers would be."""

    def __init__(self, sink: list[Any]) -> None:
        self._sink = sink

    def publish(self, message: Any) -> None:
        """Keep the message."""
        self._sink.append(message)

    def get_subscription_count(self) -> int:
        """Nobody listens to what is made on demand."""
        return 0


class _ReplayedPerception(PerceptionNode):
    """The node itself; what it publishes is kept, what it subscribes to is fed by hand."""

    def __init__(self, **kwargs: Any) -> None:
        self.outputs: dict[str, list[Any]] = {}
        super().__init__(**kwargs)

    def create_publisher(self, kind: Any, topic: str, *_: Any, **__: Any) -> Any:
        """Keep what is published under the name that the node uses."""
        return _Captured(self.outputs.setdefault(topic, []))


def perceive_again(
    bag: Bag, story: Story, span: Span | None = None
) -> Iterator[tuple[Stamp, Cloud]]:
    """Stamp and points of the object cloud of every frame whose cloud was recorded.

    Messages are given to the node in the order of their stamps, so that neither the load of the
    machine nor the order of arrival decides anything.

    Raises:
        BagError: the recording lacks the node's parameters or a topic that it listens to.
    """
    if NODE not in story.parameters:
        raise BagError(f"the recording has no parameters of {NODE}")
    context = Context()
    rclpy.init(context=context, domain_id=own_domain(), args=[])
    node: _ReplayedPerception | None = None
    try:
        node = _ReplayedPerception(context=context, parameter_overrides=_overrides(story))
        yield from _feed(node, bag, story, span)
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown(context=context)


def _overrides(story: Story) -> list[Parameter]:
    values = story.parameters[NODE]
    return [
        Parameter(name, value=value)
        for name, value in values.items()
        # Simulated time is of no use without a clock; an empty list has no type of its own.
        if name != "use_sim_time" and not name.startswith("qos_overrides") and value != []
    ]


def _feed(
    node: _ReplayedPerception, bag: Bag, story: Story, span: Span | None
) -> Iterator[tuple[Stamp, Cloud]]:
    callbacks = {s.topic_name: s.callback for s in node.subscriptions}
    present = {name: callback for name, callback in callbacks.items() if name in bag.topics}
    missing = sorted(set(callbacks) - set(present) - {"/parameter_events", "/heartbeat", "/clock"})
    if missing:
        raise BagError(
            f"the recording lacks what {NODE} listens to",
            got=", ".join(missing),
            hint="a node that takes camera clouds needs a recording with --profile all",
        )
    sink = node.outputs["object_cloud"]
    for message in _by_stamp(bag, present, story, span):
        present[message[0]](message[1])
        for cloud in sink:
            points = clouds.from_cloud_message(cloud, clouds.XYZ).reshape(-1, 3)
            yield key(cloud.header.stamp), np.ascontiguousarray(points)
        sink.clear()


def _by_stamp(
    bag: Bag, topics: dict[str, Any], story: Story, span: Span | None
) -> Iterator[tuple[str, Any]]:
    """Topic and message, in the order of stamps; frames only if their cloud was recorded."""
    held: list[tuple[Stamp, int, int, str, Any]] = []
    for number, entry in enumerate(bag.messages(topics, span)):
        message = decoded(bag, entry)
        kind = type(message).__name__
        stamp = key(message.header.stamp) if hasattr(message, "header") else (0, 0)
        if kind in ("Image", "PointCloud2") and stamp not in story.clouds:
            continue
        held.append((stamp, _ORDER.get(kind, 3), number, entry.topic, message))
        newest = max(held)[0]
        if len(held) > 2000 or (held and _seconds(newest) - _seconds(min(held)[0]) > 2 * _AHEAD):
            held.sort(key=lambda h: h[:3])
            ready = [h for h in held if _seconds(newest) - _seconds(h[0]) > _AHEAD]
            held = held[len(ready) :]
            yield from ((topic, m) for *_, topic, m in ready)
    held.sort(key=lambda h: h[:3])
    yield from ((topic, m) for *_, topic, m in held)


def _seconds(stamp: Stamp) -> float:
    return stamp[0] + 1e-9 * stamp[1]
