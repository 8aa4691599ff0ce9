"""When the arm stands still somewhere new."""

from __future__ import annotations

from collections import deque

import numpy as np

from flowbothd_common.types import Array


class Stillness:
    """Watches joint positions over time.

    Args:
        hold: How long they must not change [s].
        tolerance: What is no change [rad].
        apart: In some joint, how far a new place must be from those taken before [rad].
    """

    def __init__(self, hold: float = 0.7, tolerance: float = 0.003, apart: float = 0.1) -> None:
        self._hold, self._tolerance, self._apart = hold, tolerance, apart
        self._recent: deque[tuple[float, Array]] = deque()
        self._taken: list[Array] = []

    def add(self, stamp: float, positions: Array) -> None:
        """Take in joint positions; a step back in time starts over."""
        if self._recent and stamp < self._recent[-1][0]:
            self._recent.clear()
        self._recent.append((stamp, positions))
        while len(self._recent) > 2 and self._recent[1][0] <= stamp - self._hold:
            self._recent.popleft()

    def ready(self, stamp: float) -> Array | None:
        """Joint positions if the arm stood still up to `stamp`, somewhere new; otherwise None."""
        if not self._recent or self._recent[-1][0] - self._recent[0][0] < self._hold:
            return None
        if not self._recent[0][0] + self._hold <= stamp <= self._recent[-1][0] + 0.05:
            return None
        rows = np.array([row for _, row in self._recent])
        here = rows.mean(axis=0)
        if np.ptp(rows, axis=0).max() > self._tolerance:
            return None
        if any(np.abs(here - old).max() < self._apart for old in self._taken):
            return None
        return np.asarray(here)

    def taken(self, positions: Array) -> None:
        """Note that a picture was taken here."""
        self._taken.append(positions)
