"""Records the topics of a graph as they come, with all that a replay needs to know."""

from __future__ import annotations

import datetime
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from flowbothd_common.ros import diagnostics
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from flowbothd_rosbag import about
from flowbothd_rosbag.graph_parameters_ros import GraphParameters, Values
from flowbothd_rosbag.metadata import BagError, Topic
from flowbothd_rosbag.qos_ros import listening, to_words
from flowbothd_rosbag.recorder_params import RecorderParams, wanted
from flowbothd_rosbag.recording import Recording
from flowbothd_rosbag.types_ros import message_class
from flowbothd_rosbag.weights import describe_later, models_in_use
from flowbothd_rosbag.writer import BagWriter

_LARGE = ("sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2")
_LARGE_DEPTH, _DEPTH = 60, 2000
_AT_ONCE = 50  # Waiting messages of one topic that are taken before the others have their turn.
_DESCRIPTION = "robot_description"
_SETTLE = 1.0
"""Seconds without news after which the parameters of a graph count as complete."""


class RecorderNode(Node):
    """Subscribes to whatever appears and hands it to a thread that writes."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("recorder_node", **kwargs)
        self._params = declare(self, RecorderParams)
        now = datetime.datetime.now().astimezone()
        folder = Path(self._params.out or f"bags/{now:%Y-%m-%d_%H-%M-%S}")
        self.recording = Recording(BagWriter(folder), int(self._params.queue_mb * 1e6))
        self._attach(about.VERSIONS, about.versions_text())
        self._hear: dict[str, Any] = {}
        self._refused: set[str] = set()
        self._gaps: Counter[str] = Counter()
        self._lost: Counter[str] = Counter()
        self._last_sequence: dict[str, int] = {}
        self._publishers_of: dict[str, int] = {}
        self._known: dict[str, Values] = {}
        self._known_since = 0.0
        self._closed = False
        self._status = diagnostics.NodeStatus(self)
        self._graph = GraphParameters(self, self._on_parameters)
        # The steady clock runs on when the simulation, and with it the node clock, is gone.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(self._params.discovery_period, self._look, clock=steady)
        self.get_logger().info(f"recording to {folder} (profile {self._params.profile})")
        self._look()

    def destroy_node(self) -> None:
        """Complete the recording."""
        self._status.close()
        if not self._closed:
            self._closed = True
            try:
                self.recording.close()
            finally:
                self._tell_end()
        super().destroy_node()

    def _tell_end(self) -> None:
        size = self.recording.written / 1e6
        sys.stderr.write(f"recorded {self.recording.counts.total()} messages, {size:.1f} MB\n")
        if lost := self._all_lost():
            sys.stderr.write(f"lost messages: {lost}\n")

    def _all_lost(self) -> dict[str, int]:
        # Numbers tell of gaps where one publisher counts; with several only the middleware knows.
        seen = {
            n: (self._gaps if k == 1 else self._lost)[n] for n, k in self._publishers_of.items()
        }
        return {n: k for n in seen if (k := seen[n] + self.recording.dropped[n])}

    def _look(self) -> None:
        """Subscribe to what is new, and tell how it goes."""
        if self.recording.failure is not None:
            raise self.recording.failure
        for name, kinds in self.get_topic_names_and_types():
            if name not in self._refused and wanted(name, kinds[0], self._params):
                self._consider(name, kinds[0])
        self._graph.look()
        self._store_parameters()
        figures = {"MB": f"{self.recording.written / 1e6:.0f}", "topics": len(self._hear)}
        if lost := self._all_lost():
            # The counts grow all the time; what is said changes only with the topics.
            figures |= {f"lost {name}": count for name, count in lost.items()}
            names = ", ".join(sorted(lost))
            self._status.report(diagnostics.WARN, f"messages were lost on {names}", figures)
        else:
            self._status.report(diagnostics.OK, "recording", figures)

    def _consider(self, name: str, kind: str) -> None:
        offers = self.get_publishers_info_by_topic(name)
        known = self._publishers_of.get(name, 0)
        if not offers or len(offers) == known:
            return
        self._publishers_of[name] = len(offers)
        self._last_sequence.pop(name, None)
        profiles = [to_words(offer.qos_profile) for offer in offers]
        unique = [p for i, p in enumerate(profiles) if p not in profiles[:i]]
        topic = Topic(name, kind, tuple(unique), str(offers[0].topic_type_hash))
        try:
            cls = message_class(kind)
        except BagError as error:
            self._refused.add(name)
            self.get_logger().warning(f"{name} is not recorded: {error}")
            return
        self.recording.add_topic(topic)
        if name in self._hear:
            return
        depth = _LARGE_DEPTH if kind in _LARGE else _DEPTH
        profile = listening([offer.qos_profile for offer in offers], depth)
        self._hear[name] = self._subscribe(cls, name, profile)

    def _subscribe(self, cls: Any, name: str, profile: Any) -> Any:
        def on_message(data: bytes, info: dict[str, Any]) -> None:
            self._take(name, data, info)
            # Waiting anew for every message is most of the work; a backlog goes without.
            for _ in range(_AT_ONCE):
                entry = subscription.handle.take_message(cls, True)
                if entry is None:
                    return
                self._take(name, *entry)

        try:
            subscription = self.create_subscription(
                cls,
                name,
                on_message,
                profile,
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(
                    message_lost=lambda e: self._lost.update({name: e.total_count_change})
                ),
            )
        except UnsupportedEventTypeError:
            subscription = self.create_subscription(cls, name, on_message, profile, raw=True)
        return subscription

    def _take(self, name: str, data: bytes, info: dict[str, Any]) -> None:
        received = info["received_timestamp"] or time.time_ns()
        self.recording.take(name, received, info["source_timestamp"], data)
        if self._publishers_of[name] == 1:
            self._check_sequence(name, info.get("publication_sequence_number"))
        if name.endswith("/" + _DESCRIPTION):
            text = deserialize_message(data, String).data
            self.recording.attach(about.DESCRIPTION, "application/xml", text.encode())

    def _check_sequence(self, name: str, sequence: int | None) -> None:
        """Notice gaps between the numbers that the middleware gives to one publisher's messages."""
        last = self._last_sequence.get(name)
        if sequence and last and sequence > last + 1:
            self._gaps[name] += sequence - last - 1
        self._last_sequence[name] = sequence or 0

    def _on_parameters(self, parameters: dict[str, Values]) -> None:
        self._known, self._known_since = parameters, time.monotonic()

    def _store_parameters(self) -> None:
        """Store what the nodes answered once no more answers come; again when more do."""
        if not self._known or time.monotonic() - self._known_since < _SETTLE:
            return
        known, self._known = self._known, {}
        for name, text in (
            (about.PARAMETERS, about.parameters_text(known)),
            (about.CALIBRATION, about.calibration_text(known)),
        ):
            if text:
                self._attach(name, text)
        models = models_in_use(known)
        if models:
            describe_later(models, lambda text: self._attach(about.WEIGHTS, text))

    def _attach(self, name: str, text: str) -> None:
        self.recording.attach(name, "application/yaml", text.encode())


def main(args: list[str] | None = None) -> int:
    """Record until told to stop."""
    return run_node(RecorderNode, args)


if __name__ == "__main__":
    sys.exit(main())
