"""Takes messages from a thread that must not wait, and writes them from one that may."""

from __future__ import annotations

import logging
import threading
from collections import Counter, deque
from typing import NamedTuple

from flowbothd_rosbag.metadata import BagError, Topic
from flowbothd_rosbag.writer import BagWriter

_LOG = logging.getLogger(__name__)

_URGENT_SHARE = 0.03
"""Filling of the queue above which compression is fast rather than good."""


class _Item(NamedTuple):
    topic: str
    received: int
    sent: int
    data: bytes


class Recording:
    """A recording fed from callbacks.

    Args:
        writer: Is closed by `close`; used by the thread of this object alone.
        limit: Bytes that may wait to be written; what comes beyond is dropped and counted.
    """

    def __init__(self, writer: BagWriter, limit: int) -> None:
        self._writer, self._limit = writer, limit
        self._queue: deque[_Item | tuple[str, str, bytes] | Topic] = deque()
        self._wake = threading.Condition()
        self._waiting = 0
        self._closing = False
        self.counts: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self.failure: BagError | None = None
        self._thread = threading.Thread(target=self._run, name="bag_writer", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Bytes that wait to be written."""
        return self._waiting

    @property
    def written(self) -> int:
        """Bytes of the file so far."""
        return self._writer.size

    def add_topic(self, topic: Topic) -> None:
        """Announce a topic, or more that became known of it."""
        self._put(topic, 0)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Store a file with the messages."""
        self._put((name, media_type, data), len(data))

    def take(self, topic: str, received: int, sent: int, data: bytes) -> None:
        """Take a message; never waits."""
        if self._waiting + len(data) > self._limit:
            self.dropped[topic] += 1
            return
        self.counts[topic] += 1
        self._put(_Item(topic, received, sent, data), len(data))

    def close(self, timeout: float = 30.0) -> None:
        """Write what waits and complete the recording.

        Raises:
            BagError: the disk is full, or so slow that it took longer than `timeout` seconds.
        """
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(timeout)
        if self._thread.is_alive():
            raise BagError(
                f"{self._waiting} bytes were not written in {timeout:g} s",
                hint="the disk is too slow; what was written before is kept",
            )
        if self.failure is not None:
            raise self.failure

    def _put(self, item: _Item | tuple[str, str, bytes] | Topic, size: int) -> None:
        with self._wake:
            self._queue.append(item)
            self._waiting += size
            self._wake.notify()

    def _run(self) -> None:
        try:
            self._work()
        except BagError as error:
            self.failure = error
            _LOG.error("%s", error)
        try:
            self._writer.close()
        except BagError as error:
            self.failure = self.failure or error

    def _work(self) -> None:
        while True:
            with self._wake:
                if not self._queue and not self._closing:
                    self._wake.wait(timeout=0.5)
                batch = list(self._queue)
                self._queue.clear()
                closing = self._closing
            for item in batch:
                self._write(item)
            self._writer.flush_when_due()
            if closing and not batch:
                return

    def _write(self, item: _Item | tuple[str, str, bytes] | Topic) -> None:
        if isinstance(item, Topic):
            self._writer.add_topic(item)
        elif isinstance(item, _Item):
            urgent = self._waiting > _URGENT_SHARE * self._limit
            self._writer.write(item.topic, item.received, item.data, sent=item.sent, urgent=urgent)
            with self._wake:
                self._waiting -= len(item.data)
        else:
            self._writer.attach(*item)
            with self._wake:
                self._waiting -= len(item[2])
