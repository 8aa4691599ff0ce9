"""Plays a recording: its messages at their times, its time as /clock."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage

from flowbothd_common.ros import qos
from flowbothd_common.ros.conversions import to_stamp
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from flowbothd_rosbag.metadata import BagError
from flowbothd_rosbag.player_params import PlayerParams
from flowbothd_rosbag.prefetch import prefetched
from flowbothd_rosbag.qos_ros import publishing
from flowbothd_rosbag.reader import Bag, Message, Span
from flowbothd_rosbag.types_ros import message_class

CLOCK = "/clock"
_CLOCK_PERIOD = 10_000_000
"""Bag time between two messages on a clock that is made [ns]."""

_LAST_ACK = Duration(seconds=1.0)

_NOT_PLAYED = ("/parameter_events", "/rosout")


class Ended(SystemExit):
    """The recording is over."""


class PlayerNode(Node):
    """Publishes what a recording holds."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("player_node", **kwargs)
        self._params = declare(self, PlayerParams)
        self._bag = Bag(Path(self._params.bag))
        self._span = Span(self._params.begin, self._params.end or None)
        self._publishers_by_name = self._create_publishers()
        self._own_clock = None
        if CLOCK not in self._publishers_by_name:
            self._own_clock = self.create_publisher(ClockMessage, CLOCK, qos.STATE)
            self._tell("no /clock in it: time is made from when its messages were received")
        for problem in self._bag.problems:
            self._tell(problem)
        self.played = 0
        self.latest = 0.0
        self._messages: Iterator[Message] | None = None
        self._next: Message | None = None
        self._zero = (0, 0.0)
        self._clock_told = 0
        self._created = time.monotonic()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(0.002, self._on_timer, clock=steady)

    def _tell(self, text: str) -> None:
        self.get_logger().warning(text)

    def _create_publishers(self) -> dict[str, Any]:
        exclude, result, refused = self._params.exclude, {}, []
        for topic in self._bag.topics.values():
            hidden = "/_" in topic.name or topic.name in _NOT_PLAYED
            if hidden or (exclude and re.search(exclude, topic.name)):
                continue
            if topic.serialization != "cdr":
                refused.append(f"{topic.name} ({topic.serialization}, not cdr)")
                continue
            try:
                cls = message_class(topic.type)
                result[topic.name] = self.create_publisher(cls, topic.name, publishing(topic))
            except BagError as error:
                refused.append(f"{topic.name} ({error.what})")
        if refused:
            self._tell(f"not played: {', '.join(refused)}")
        if not result:
            raise BagError(f"nothing in {self._bag.path} can be played", got=self._bag.problems)
        return result

    def _ready(self) -> bool:
        waited = time.monotonic() - self._created
        missing = [
            name
            for name in self._params.wait_for
            if name in self._publishers_by_name
            and not self._publishers_by_name[name].get_subscription_count()
        ]
        if missing and waited > self._params.wait_timeout:
            raise BagError(f"nobody listens to {', '.join(missing)}", got=f"waited {waited:.0f} s")
        return not missing and waited > self._params.delay

    def _begin(self) -> bool:
        """Go to the beginning; False if there is nothing to play."""
        if self._span.begin > 0:
            self._publish_latched()
        names = list(self._publishers_by_name)
        self._messages = prefetched(self._bag.messages(names, self._span))
        self._next = next(self._messages, None)
        if self._next is None:
            return False
        self._zero = (self._next.time, time.monotonic())
        self._clock_told = 0
        self.get_logger().info(f"playing {self._bag.path} at {self._params.rate:g} x")
        return True

    def _publish_latched(self) -> None:
        """Give late joiners what they would have been given before the chosen part begins."""
        latched = [n for n, t in self._bag.topics.items() if t.latched]
        last: dict[str, Message] = {}
        for message in self._bag.messages(latched, Span(0.0, self._span.begin)):
            last[message.topic] = message
        for message in last.values():
            if message.topic in self._publishers_by_name:
                self._publishers_by_name[message.topic].publish(message.data)

    def _on_timer(self) -> None:
        if self._messages is None:
            if self._ready() and not self._begin():
                self._end("nothing was recorded in the chosen part")
            return
        now = self._bag_time()
        while self._next is not None and self._next.time <= now:
            self._publish(self._next, now)
            self._next = next(self._messages, None)
            now = self._bag_time()
        if self._next is None:
            self._finish_round()
        elif self._own_clock is not None and now - self._clock_told >= _CLOCK_PERIOD:
            self._clock_told = now
            self._own_clock.publish(ClockMessage(clock=to_stamp(now * 1e-9)))

    def _bag_time(self) -> int:
        begin, began = self._zero
        return begin + int((time.monotonic() - began) * self._params.rate * 1e9)

    def _publish(self, message: Message, now: int) -> None:
        self.latest = max(self.latest, (now - message.time) * 1e-9 / self._params.rate)
        self._publishers_by_name[message.topic].publish(message.data)
        self.played += 1

    def _finish_round(self) -> None:
        if self._params.loop:
            self.get_logger().info("from the beginning; time jumps back")
            self._begin()
        else:
            self._end(f"played {self.played} messages, at most {1e3 * self.latest:.0f} ms late")

    def _end(self, text: str) -> None:
        for problem in self._bag.problems:
            if "damaged" in problem:
                self._tell(problem)
        self._timer.cancel()
        # Whoever listens has to have the last messages before their publisher goes.
        for publisher in self._publishers_by_name.values():
            publisher.wait_for_all_acked(_LAST_ACK)
        self.get_logger().info(text)
        raise Ended(0)


def main(args: list[str] | None = None) -> int:
    """Play until the end or until told to stop."""
    return run_node(PlayerNode, args)


if __name__ == "__main__":
    sys.exit(main())
