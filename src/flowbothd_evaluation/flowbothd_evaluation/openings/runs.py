"""Runs of openings as resumable work, and the table of their records."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flowbothd_common.markdown import markdown_table
from flowbothd_evaluation.openings.task import Opening
from flowbothd_evaluation.records import OpeningRecord, Touch


@dataclass(frozen=True)
class Run:
    """One run to make.

    Attributes:
        opening: The task, with its pose.
        seed: Of the run.
        frames: Folder for its pictures, or None.
    """

    opening: Opening
    seed: int
    frames: Path | None


def make_run(work: Run) -> OpeningRecord:
    """Make one run, in whatever process."""
    from flowbothd_evaluation.openings.attempt import run_attempt

    if work.frames is None:
        return run_attempt(work.opening, work.seed)
    from flowbothd_evaluation.openings.strip import Strip

    strip = Strip(work.opening)
    record = run_attempt(work.opening, work.seed, strip)
    strip.save(strip_file(work.frames, work.opening.name, work.seed))
    return record


def strip_file(folder: Path, task: str, seed: int) -> Path:
    """Where the pictures of a run are."""
    return folder / f"{task}_{seed}.png"


_HEAD = (
    *("task", "wanted", "reached, median / least", "opened", "no break, no touch", "both"),
    *("suction breaks", "touched", "peak force opening / all [N]", "peak torque [Nm]"),
)


def table(openings: Mapping[str, Opening], records: Sequence[OpeningRecord]) -> str:
    """Return a table in Markdown: one row a task that has records."""
    by_task = {name: [r for r in records if r.task == name] for name in openings}
    rows = [_row(openings[name], own) for name, own in by_task.items() if own]
    return markdown_table(_HEAD, rows)


def _row(opening: Opening, records: Sequence[OpeningRecord]) -> tuple[object, ...]:
    scale, unit = opening.shown_in
    reached = scale * np.array([r.reached for r in records])
    both = sum(r.opened and r.clean for r in records)
    force = max(r.peak_force.get("open", 0.0) for r in records)
    return (
        opening.name,
        f"{scale * opening.wanted:.1f} {unit}",
        f"{np.median(reached):.1f} / {reached.min():.1f}",
        sum(r.opened for r in records),
        sum(r.clean for r in records),
        f"**{both} of {len(records)}**",
        sum(len(r.suction_breaks) for r in records),
        _touched(records),
        f"{force:.0f} / {largest(r.peak_force for r in records):.0f}",
        f"{largest(r.peak_torque for r in records):.1f}",
    )


def largest(peaks: Iterable[Mapping[str, float]]) -> float:
    """Return the largest force or torque of some runs, in any phase."""
    return max(max(by_phase.values(), default=0.0) for by_phase in peaks)


def _touched(records: Sequence[OpeningRecord]) -> str:
    """The hardest touch of every pair, and in how many runs."""
    pairs: dict[str, list[Touch]] = {}
    for record in records:
        for touch in record.touches:
            pairs.setdefault(f"{touch.link} - {touch.thing}", []).append(touch)
    texts = []
    for pair, touches in pairs.items():
        worst = max(touches, key=lambda touch: touch.peak)
        texts.append(f"{pair} {len(touches)}x, {worst.peak:.0f} N ({worst.phase})")
    return "; ".join(texts) or "never"
