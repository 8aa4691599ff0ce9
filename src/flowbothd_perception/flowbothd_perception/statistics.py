"""Processing times and counts of a camera's frames."""

from __future__ import annotations

from collections import deque

import numpy as np

from flowbothd_perception.pipeline import PerceptionResult

_WINDOW = 1800
"""Frames that timings are about: a minute at 30 Hz."""


class FrameStatistics:
    """Counts and timings of the last frames, for diagnostics; times are of a steady clock [s]."""

    def __init__(self) -> None:
        self._arrivals: deque[float] = deque(maxlen=_WINDOW)
        self._latencies: deque[float] = deque(maxlen=_WINDOW)
        self._received = self._published = self._dropped = 0
        self._last: PerceptionResult | None = None

    def arrived(self, now: float) -> None:
        """A frame came in."""
        self._received += 1
        self._arrivals.append(now)

    def dropped(self) -> None:
        """A frame was not turned into a cloud."""
        self._dropped += 1

    def published(self, result: PerceptionResult, latency: float) -> None:
        """A frame's cloud went out `latency` after the frame came in."""
        self._published += 1
        self._latencies.append(latency)
        self._last = result

    def figures(self, now: float) -> dict[str, object]:
        """Figures for diagnostics, by name."""
        recent = [at for at in self._arrivals if now - at <= 2.0]
        figures: dict[str, object] = {
            "frames received": self._received,
            "frames published": self._published,
            "frames dropped": self._dropped,
            "frame rate [Hz]": f"{len(recent) / 2.0:.1f}",
        }
        if self._latencies:
            ordered = 1e3 * np.array(self._latencies)
            figures["latency median [ms]"] = f"{np.median(ordered):.1f}"
            figures["latency p99 [ms]"] = f"{np.percentile(ordered, 99):.1f}"
        if self._last is not None:
            figures |= {f"points {stage}": n for stage, n in self._last.counts.items()}
            for stage, seconds in self._last.seconds.items():
                figures[f"{stage} [ms]"] = f"{1e3 * seconds:.1f}"
        return figures
