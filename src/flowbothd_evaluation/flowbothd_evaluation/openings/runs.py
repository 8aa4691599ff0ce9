"""Runs of openings as resumable work, and the table of their records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flowbothd_evaluation.openings.task import Opening
from flowbothd_evaluation.resumable import Record


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


def key_of(opening: Opening, seed: int) -> tuple[Any, ...]:
    """What tells a run from others: another pose is another run."""
    return opening.name, seed, (*opening.position, opening.yaw, *opening.grasp)


def record_key(record: Record) -> tuple[Any, ...]:
    """The same of its record."""
    return record["task"], record["seed"], tuple(record["at"])


def make_run(work: Run) -> Record:
    """Make one run, in whatever process."""
    from flowbothd_evaluation.openings.attempt import run_attempt

    key = key_of(work.opening, work.seed)
    if work.frames is None:
        record = run_attempt(work.opening, work.seed)
    else:
        from flowbothd_evaluation.openings.strip import Strip

        strip = Strip(work.opening)
        record = run_attempt(work.opening, work.seed, strip)
        strip.save(strip_file(work.frames, work.opening.name, work.seed))
    return {**record, "at": list(key[2])}


def strip_file(folder: Path, task: str, seed: int) -> Path:
    """Where the pictures of a run are."""
    return folder / f"{task}_{seed}.png"


def table(openings: dict[str, Opening], records: Sequence[Record]) -> str:
    """Markdown: one row a task."""
    lines = [
        "| task | wanted | reached, median / least | opened | no break, no touch | both "
        "| suction breaks | touched | peak force opening / all [N] | peak torque [Nm] |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, opening in openings.items():
        rows = [r for r in records if r["task"] == name]
        scale, unit = opening.shown_in
        reached = scale * np.array([r["reached"] for r in rows])
        both = sum(r["opened"] and r["clean"] for r in rows)
        force = max(r["peak_force"].get("open", 0.0) for r in rows)
        lines.append(
            f"| {name} | {scale * opening.wanted:.1f} {unit} "
            f"| {np.median(reached):.1f} / {reached.min():.1f} "
            f"| {sum(r['opened'] for r in rows)} | {sum(r['clean'] for r in rows)} "
            f"| **{both} of {len(rows)}** | {sum(len(r['suction_breaks']) for r in rows)} "
            f"| {_touched(rows)} | {force:.0f} / {peak(rows, 'peak_force'):.0f} "
            f"| {peak(rows, 'peak_torque'):.1f} |"
        )
    return "\n".join(lines)


def peak(rows: Sequence[Record], name: str) -> float:
    """Largest force or torque of some runs, in any phase."""
    return max(max(r[name].values(), default=0.0) for r in rows)


def _touched(rows: Sequence[Record]) -> str:
    """The hardest touch of every pair, and in how many runs."""
    pairs: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        for touch in row["touches"]:
            pairs.setdefault(f"{touch['link']} - {touch['thing']}", []).append(touch)
    texts = []
    for pair, touches in pairs.items():
        worst = max(touches, key=lambda touch: float(touch["peak"]))
        texts.append(f"{pair} {len(touches)}x, {worst['peak']:.0f} N ({worst['phase']})")
    return "; ".join(texts) or "never"
