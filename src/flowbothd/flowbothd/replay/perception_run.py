"""The perception node once more on recorded frames, without timing: every frame is processed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter

from flowbothd.replay.story import Stamp, Story, decoded, key, seconds
from flowbothd_common.environment import own_domain
from flowbothd_common.ros import clouds
from flowbothd_common.ros.conversions import to_seconds
from flowbothd_common.types import Cloud
from flowbothd_perception.perception_node import PerceptionNode
from flowbothd_rosbag.lookup import topic_called
from flowbothd_rosbag.metadata import BagError
from flowbothd_rosbag.reader import Bag, Span
from flowbothd_rosbag.types_ros import type_of

NODE = "perception_node"

_ORDER = {"String": 0, "CameraInfo": 1, "JointState": 2}
"""Of messages with the same stamp: what a frame needs comes before it."""

_FRAMES = ("Image", "PointCloud2")

_AHEAD = 1.0
"""How late a message may be received behind others of its stamp and still find its place [s]."""

_LEADS = 4
"""Joint states that may have come too late for a frame."""


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


@dataclass(frozen=True)
class Perceived:
    """Recomputed output of the node.

    Attributes:
        clouds: (N, 3) object clouds by stamp of the frame.
        begin: Stamp from which on all that the node listens to was being recorded [s]. Earlier
            frames came out in the recorded run if its node heard what the recorder did not.
    """

    clouds: dict[Stamp, Cloud]
    begin: float


def perceive_again(bag: Bag, story: Story, span: Span | None = None) -> Perceived:
    """Object cloud of every frame whose cloud was recorded.

    Messages are given to the node in the order of their stamps, so that neither the load of the
    machine nor the order of arrival decides anything. One thing the recording does not say: which
    joint states the node had when it took a frame. It does not wait for the last ones before a
    frame but extrapolates a little, so where the cloud is not the recorded one, the frame is given
    to it again ahead of up to `_LEADS` joint states, and what fits the recording is taken.

    Raises:
        BagError: the recording lacks the node's parameters or a topic that it listens to.
    """
    if NODE not in story.parameters:
        raise BagError(f"the recording has no parameters of {NODE}")
    with _fresh_node(story) as node:
        inputs = _inputs(node, bag)
        begin = _begin(bag, inputs, span)
        result = dict(_feed(node, bag, inputs, frozenset(story.clouds), 0.0, span))
    period = joint_period(bag, span)
    for lead in range(1, _LEADS + 1):
        other = frozenset(
            stamp
            for stamp, points in story.clouds.items()
            if stamp not in result or not np.array_equal(result[stamp], points)
        )
        if not other:
            break
        with _fresh_node(story) as node:
            inputs = _inputs(node, bag)
            for stamp, points in _feed(node, bag, inputs, other, (lead - 0.5) * period, span):
                if np.array_equal(points, story.clouds[stamp]):
                    result[stamp] = points
    return Perceived(result, begin)


def joint_period(bag: Bag, span: Span | None = None) -> float:
    """Median time between joint states [s]; 0 if there are none."""
    topic = topic_called(bag, "joint_states", "sensor_msgs/msg/JointState")
    stamps = []
    for message in bag.messages([topic] if topic else [], span):
        stamps.append(to_seconds(decoded(bag, message).header.stamp))
        if len(stamps) > 500:
            break
    return float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0


@contextmanager
def _fresh_node(story: Story) -> Iterator[_ReplayedPerception]:
    """The node as it was set up then, having heard nothing yet."""
    context = Context()
    rclpy.init(context=context, domain_id=own_domain(), args=[])
    node: _ReplayedPerception | None = None
    try:
        node = _ReplayedPerception(context=context, parameter_overrides=_overrides(story))
        yield node
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


def _inputs(node: _ReplayedPerception, bag: Bag) -> Mapping[str, Callable[[Any], None]]:
    """Callback of the node for every recorded topic that it subscribes to."""
    heard = [s for s in node.subscriptions if s.topic_name not in ("/parameter_events", "/clock")]
    names = {
        s.topic_name: topic_called(bag, s.topic_name.lstrip("/"), type_of(s.msg_type))
        for s in heard
    }
    present = {name: s.callback for s in heard if (name := names[s.topic_name]) is not None}
    missing = sorted(n for n, found in names.items() if found is None and n != "/heartbeat")
    if missing:
        raise BagError(
            f"the recording lacks what {NODE} listens to",
            got=", ".join(missing),
            hint="a node that takes camera clouds needs a recording with --profile all",
        )
    return present


def _begin(bag: Bag, topics: Collection[str], span: Span | None) -> float:
    """Stamp of the first message of the topic with stamps that was last to be recorded [s]."""
    firsts = [0.0]
    for topic in topics:
        for entry in bag.messages([topic], span):
            message = decoded(bag, entry)
            if hasattr(message, "header"):
                firsts.append(to_seconds(message.header.stamp))
            break
    return max(firsts)


def _feed(
    node: _ReplayedPerception,
    bag: Bag,
    inputs: Mapping[str, Callable[[Any], None]],
    stamps: frozenset[Stamp],
    lead: float,
    span: Span | None,
) -> Iterator[tuple[Stamp, Cloud]]:
    """Stamp and points for frames with the given stamps, each `lead` seconds ahead of its time."""
    sink = node.outputs["object_cloud"]
    for topic, message in _by_stamp(bag, inputs, stamps, lead, span):
        inputs[topic](message)
        for cloud in sink:
            points = clouds.from_cloud_message(cloud, clouds.XYZ).reshape(-1, 3)
            yield key(cloud.header.stamp), np.ascontiguousarray(points)
        sink.clear()


def _by_stamp(
    bag: Bag,
    topics: Collection[str],
    stamps: frozenset[Stamp],
    lead: float,
    span: Span | None,
) -> Iterator[tuple[str, Any]]:
    """Topic and message in the order of stamps; frames only if their stamp is among `stamps`."""
    held: list[tuple[float, int, int, str, Any]] = []
    newest = 0.0
    for number, entry in enumerate(bag.messages(topics, span)):
        message = decoded(bag, entry)
        kind = type(message).__name__
        stamp = key(message.header.stamp) if hasattr(message, "header") else (0, 0)
        at = seconds(stamp)
        if kind in _FRAMES:
            if stamp not in stamps:
                continue
            at -= lead
        newest = max(newest, at)
        held.append((at, _ORDER.get(kind, 3), number, entry.topic, message))
        if newest - held[0][0] > 2 * _AHEAD:
            held.sort(key=lambda h: h[:3])
            ready = [h for h in held if newest - h[0] > _AHEAD]
            held = held[len(ready) :]
            yield from ((topic, m) for *_, topic, m in ready)
    held.sort(key=lambda h: h[:3])
    yield from ((topic, m) for *_, topic, m in held)
