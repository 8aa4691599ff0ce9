"""Reads ahead on a thread of its own, so that unpacking does not make messages late."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")
_POLL = 0.2


def prefetched(items: Iterable[T], ahead: int = 50) -> Iterator[T]:
    """The same items, up to `ahead` of them read before they are asked for.

    An error of the source is raised here, after the items before it.
    """
    found: queue.Queue[tuple[T | None, BaseException | None]] = queue.Queue(ahead)
    stop = threading.Event()

    def give(entry: tuple[T | None, BaseException | None]) -> None:
        while not stop.is_set():
            try:
                found.put(entry, timeout=_POLL)
            except queue.Full:
                continue
            return

    def read() -> None:
        error: BaseException | None = None
        try:
            for item in items:
                give((item, None))
                if stop.is_set():
                    return
        except Exception as caught:
            error = caught
        give((None, error or StopIteration()))

    threading.Thread(target=read, name="prefetch", daemon=True).start()
    try:
        while True:
            item, error = found.get()
            if isinstance(error, StopIteration):
                return
            if error is not None:
                raise error
            yield item  # type: ignore[misc]
    finally:
        stop.set()
