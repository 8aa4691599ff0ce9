"""Keeping a stepped simulation in real time, and noticing when its commander falls silent."""

from __future__ import annotations

from collections import deque


class Pacer:
    """Tells how many ticks are due on a steady clock.

    After a stall it catches up at most `max_ticks` at once; what is beyond `max_debt` is given up,
    and shows in the real-time factor.
    """

    def __init__(self, time_step: float, max_ticks: int = 12, max_debt: float = 0.5) -> None:
        """Pace ticks of `time_step` seconds.

        Args:
            time_step: Simulated time of one tick [s].
            max_ticks: Most ticks that are due at once.
            max_debt: Most simulated time that is still caught up [s].
        """
        self._step = time_step
        self._max_ticks = max_ticks
        self._max_debt = max_debt
        self._start: float | None = None
        self._done = 0
        self._window: deque[tuple[float, int]] = deque()
        self._total = 0

    def due(self, now: float) -> int:
        """Ticks to be made now; the caller makes all of them."""
        if self._start is None:
            self._start = now
        behind = (now - self._start) / self._step - self._done
        if behind * self._step > self._max_debt:
            lost = behind * self._step - self._max_debt
            self._start += lost
            behind -= lost / self._step
        ticks = max(0, min(int(behind + 1e-6), self._max_ticks))
        self._done += ticks
        self._total += ticks
        self._window.append((now, self._total))
        while len(self._window) > 2 and now - self._window[1][0] >= 1.0:
            self._window.popleft()
        return ticks

    def skip(self, now: float) -> None:
        """Forget time that went by while nothing was meant to move, such as a reset."""
        self._start, self._done = now, 0
        self._window.clear()

    def factor(self) -> float:
        """Simulated over real time during the last second; 0 as long as nothing is known."""
        if len(self._window) < 2:
            return 0.0
        (before, first), (after, last) = self._window[0], self._window[-1]
        return (last - first) * self._step / (after - before) if after > before else 0.0


class Watchdog:
    """Silent means: heard once, and then not for longer than the timeout.

    Time in which the listener itself was stalled does not count: nothing can be heard in it.
    """

    def __init__(self, timeout: float) -> None:
        """Listen with a timeout in seconds of a steady clock."""
        self._timeout = timeout
        self._heard: float | None = None
        self._checked: float | None = None

    def heard(self, now: float) -> None:
        """Note a sign of life."""
        self._heard = now

    def silent(self, now: float) -> bool:
        """Return True if the other side is silent; call this often."""
        stall = 0.0 if self._checked is None else now - self._checked - self._timeout / 2
        self._checked = now
        if self._heard is None:
            return False
        if stall > 0:
            self._heard = min(now, self._heard + stall)
        return now - self._heard > self._timeout
