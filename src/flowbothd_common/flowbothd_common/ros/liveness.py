"""Signs of life between nodes, timed on the steady clock so that a dead simulation is noticed."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

from rclpy.node import Node
from std_msgs.msg import Header

from flowbothd_common.ros import qos
from flowbothd_interfaces.msg import Heartbeat

PERIOD = 0.2
"""Seconds between two heartbeats of a node; 5 Hz."""

SILENCE = 0.7
"""Seconds of silence after which a peer is missing; leaves time to say so within one second."""

_REFUSED_IN_A_ROW = 2
"""Refused messages without a good one between them that make a source silent at once: unlike a
late message, a bad one leaves nothing to wait for, but a single one may be a glitch."""


class HeartbeatPublisher:
    """Publishes `heartbeat` from its own thread, so that a busy executor does not look dead.

    Only the thread dies with the process; a node that hangs in a callback goes on beating, and
    says through `set_ready` what it waits for.
    """

    def __init__(self, node: Node, period: float = PERIOD) -> None:
        self._node = node
        self._publisher = node.create_publisher(Heartbeat, "heartbeat", qos.HEARTBEAT)
        self._ready, self._detail = False, "starting"
        self._period = period
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)
        self._thread.start()

    def set_ready(self, ready: bool, detail: str = "") -> None:
        """Say whether the node can do its work, and if not, what is missing."""
        self._ready, self._detail = ready, detail

    def close(self) -> None:
        """Stop beating; to be called before the node is destroyed."""
        self._stop.set()
        self._thread.join(timeout=2.0)

    def _run(self) -> None:
        name = self._node.get_name()
        while not self._stop.wait(self._period) and self._node.context.ok():
            header = Header(stamp=self._node.get_clock().now().to_msg())
            self._publisher.publish(
                Heartbeat(header=header, node=name, ready=self._ready, detail=self._detail)
            )


class MotionHeartbeat:
    """Publishes `motion/heartbeat` at 20 Hz from its own thread, independent of planning."""

    def __init__(self, node: Node, period: float = 0.05) -> None:
        self._node = node
        self._publisher = node.create_publisher(Header, "motion/heartbeat", qos.HEARTBEAT)
        self._period = period
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="motion_heartbeat", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop beating; the driver of the arm then holds it."""
        self._stop.set()
        self._thread.join(timeout=2.0)

    @property
    def silent(self) -> bool:
        """Whether it beats no more, so that the arm's driver holds the arm."""
        return self._stop.is_set()

    def silence(self) -> None:
        """Stop beating for good, without waiting for the thread."""
        self._stop.set()

    def _run(self) -> None:
        while not self._stop.wait(self._period) and self._node.context.ok():
            self._publisher.publish(Header(stamp=self._node.get_clock().now().to_msg()))


@dataclass
class Silence:
    """Times on the steady clock when each source was last heard; free of ROS.

    Time in which the listener itself was stalled does not count: nothing can be heard in it. Ask
    several times per timeout. A source whose messages are refused is silent at the second one.

    Attributes:
        timeout: Seconds after which a source that was heard before is missing.
    """

    timeout: float = SILENCE
    _last: dict[str, float] = field(default_factory=dict)
    _asked: float | None = None
    _refused: dict[str, tuple[int, str]] = field(default_factory=dict)

    def heard(self, name: str, now: float | None = None) -> None:
        """Note that `name` gave a sign of life."""
        self._last[name] = time.monotonic() if now is None else now
        self._refused.pop(name, None)

    def refused(self, name: str, why: str) -> None:
        """Note that `name` sent a message that counts as not received."""
        self._refused[name] = (self._refused.get(name, (0, ""))[0] + 1, why)

    def last_refused(self, name: str) -> bool:
        """Return whether the last message of `name` was refused."""
        return name in self._refused

    def why(self, name: str, now: float | None = None) -> str:
        """Return how long `name` has been silent and what it sent instead, in words."""
        age = self.age(name, now)
        text = f"no {name} yet" if age == float("inf") else f"no {name} for {age:.1f} s"
        count, reason = self._refused.get(name, (0, ""))
        return f"{text}: {count} refused, {reason}" if count else text

    def ever(self, name: str) -> bool:
        """Return whether `name` was heard at all."""
        return name in self._last

    def age(self, name: str, now: float | None = None) -> float:
        """Seconds since `name` was heard; infinite if never."""
        current = time.monotonic() if now is None else now
        return current - self._last[name] if name in self._last else float("inf")

    def silent(self, names: Iterable[str], now: float | None = None) -> list[str]:
        """Those of `names` that were never heard or not for longer than the timeout."""
        current = time.monotonic() if now is None else now
        stall = 0.0 if self._asked is None else current - self._asked - self.timeout / 2
        self._asked = current
        if stall > 0:
            self._last = {name: min(current, at + stall) for name, at in self._last.items()}
        return [
            name
            for name in names
            if not self.age(name, current) <= self.timeout
            or self._refused.get(name, (0, ""))[0] >= _REFUSED_IN_A_ROW
        ]


class PeerWatch:
    """Listens to the heartbeats of other nodes.

    `missing()` names the watched nodes that are silent or not ready, with what they miss
    themselves. Nodes that were never heard are missing too.
    """

    def __init__(self, node: Node, peers: Iterable[str], timeout: float = SILENCE) -> None:
        self._peers = tuple(peers)
        self._silence = Silence(timeout)
        self._detail: dict[str, str] = {}
        self._subscription = node.create_subscription(
            Heartbeat, "heartbeat", self._on_heartbeat, qos.HEARTBEAT
        )

    def _on_heartbeat(self, message: Heartbeat) -> None:
        if message.node in self._peers:
            self._silence.heard(message.node)
            self._detail[message.node] = "" if message.ready else message.detail or "not ready"

    def silent(self) -> list[str]:
        """Names of the watched nodes that give no sign of life."""
        return self._silence.silent(self._peers)

    def ever_heard(self, name: str) -> bool:
        """Return True if the node has been heard at least once."""
        return name in self._detail

    def missing(self) -> dict[str, str]:
        """Watched nodes that cannot be relied on now: name -> what is wrong with each."""
        silent = self.silent()
        result = {}
        for name in self._peers:
            if name in silent:
                age = self._silence.age(name)
                result[name] = (
                    f"silent for {age:.1f} s" if self.ever_heard(name) else "not heard yet"
                )
            elif self._detail.get(name):
                result[name] = self._detail[name]
        return result
