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
        max_gap: Longest time between two states to interpolate over [s].
        stationary_threshold: Longer gaps are bridged, too, where no joint moved by more than this
            [rad] in them.
        max_extrapolation: How far beyond the first or last state positions are extrapolated [s].
        length: States kept.
    """

    def __init__(
        self,
        names: Sequence[str],
        max_gap: float = 0.1,
        stationary_threshold: float = 0.01,
        max_extrapolation: float = 0.02,
        length: int = 2000,
    ) -> None:
        self._names, self._max_gap, self._stationary = tuple(names), max_gap, stationary_threshold
        self._max_extrapolation, self._length = max_extrapolation, length
        self._stamps: list[float] = []
        self._positions: list[Array] = []
        self._given: tuple[str, ...] = ()
        self._order: list[int] = []

    @property
    def names(self) -> tuple[str, ...]:
        """Joints wanted, in order."""
        return self._names

    def add(self, stamp: float, names: Sequence[str], positions: Sequence[float]) -> None:
        """Take in one joint state; a stamp before the last one empties the buffer.

        Raises:
            KeyError: a wanted joint is missing; the message lists which.
            ValueError: fewer positions than names, or one that is not finite.
        """
        if len(positions) < len(names):
            raise ValueError(f"{len(names)} joint names, but {len(positions)} positions")
        if tuple(names) != self._given:
            self._order, self._given = joint_order(self._names, names), tuple(names)
        row = np.asarray(positions, dtype=float)[self._order]
        if not np.isfinite(row).all():
            raise ValueError(f"joint positions are not finite: {row.tolist()}")
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

    def reaches(self, stamp: float) -> bool:
        """Return whether states new enough for `stamp` have arrived; if not, waiting may help."""
        return bool(self._stamps) and self._stamps[-1] + self._max_extrapolation >= stamp

    def at(self, stamp: float) -> tuple[Array | None, str]:
        """(J,) joint positions at a time, linearly interpolated; or None and why not."""
        if not self._stamps:
            return None, "no joint states yet"
        late, early = stamp - self._stamps[-1], self._stamps[0] - stamp
        if late > self._max_extrapolation:
            return None, f"joint states end {late:.3f} s before the image"
        if early > self._max_extrapolation:
            return None, f"joint states begin {early:.3f} s after the image"
        if len(self._stamps) == 1:
            return self._positions[0].copy(), ""
        after = min(max(bisect_left(self._stamps, stamp), 1), len(self._stamps) - 1)
        start, end = self._stamps[after - 1], self._stamps[after]
        before = self._positions[after - 1]
        step = self._positions[after] - before
        if end - start > self._max_gap and float(np.max(np.abs(step))) > self._stationary:
            return None, f"no joint states for {end - start:.3f} s around the image"
        return before + (stamp - start) / (end - start) * step, ""
