"""Joint positions at the time of an image."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np

from flowbothd_common.motion import joint_order
from flowbothd_common.types import Array


class JointBuffer:
    """The last joint states, and what the joints were in between.

    Args:
        names: Joints wanted, in order.
        gap: Longest time between two states to interpolate over [s]; also how far an image may
            be newer than the last state without waiting for the next.
        still: Longer gaps are bridged too where no joint moved by more than this [rad] in them.
        length: States kept.
    """

    def __init__(
        self, names: Sequence[str], gap: float = 0.1, still: float = 0.01, length: int = 2000
    ) -> None:
        self._names, self._gap, self._still = tuple(names), gap, still
        self._length = length
        self._stamps: list[float] = []
        self._positions: list[Array] = []

    def add(self, stamp: float, names: Sequence[str], positions: Sequence[float]) -> None:
        """Take in one joint state; a stamp before the last one starts the buffer anew.

        Raises:
            KeyError: a wanted joint is missing; the message lists which.
        """
        row = np.asarray(positions, dtype=float)[joint_order(self._names, names)]
        if self._stamps and stamp < self._stamps[-1]:
            # Simulated time was reset, or a bag began again.
            self._stamps.clear()
            self._positions.clear()
        if self._stamps and stamp == self._stamps[-1]:
            self._positions[-1] = row
            return
        self._stamps.append(stamp)
        self._positions.append(row)
        if len(self._stamps) > self._length:
            del self._stamps[: self._length // 2], self._positions[: self._length // 2]

    def covers(self, stamp: float) -> bool:
        """Whether states as new as `stamp` have arrived; if not, it may pay to wait."""
        return bool(self._stamps) and self._stamps[-1] >= stamp

    def at(self, stamp: float) -> tuple[Array | None, str]:
        """(J,) joint positions at a time, linearly interpolated; or None and why not."""
        if not self._stamps:
            return None, "no joint states yet"
        after = bisect_left(self._stamps, stamp)
        if after == len(self._stamps):
            late = stamp - self._stamps[-1]
            if late > self._gap:
                return None, f"joint states end {late:.3f} s before the image"
            return self._positions[-1].copy(), ""
        if after == 0:
            early = self._stamps[0] - stamp
            if early > self._gap:
                return None, f"joint states begin {early:.3f} s after the image"
            return self._positions[0].copy(), ""
        start, end = self._stamps[after - 1], self._stamps[after]
        before, step = (
            self._positions[after - 1],
            self._positions[after] - self._positions[after - 1],
        )
        if end - start > self._gap and float(np.max(np.abs(step))) > self._still:
            return None, f"no joint states for {end - start:.3f} s around the image"
        return before + (stamp - start) / (end - start) * step, ""
