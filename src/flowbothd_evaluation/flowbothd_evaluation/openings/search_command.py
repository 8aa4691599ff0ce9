"""`flowbothd eval openings --search`: places judged by kinematics, the best of them simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from flowbothd_common.markdown import markdown_table
from flowbothd_evaluation.openings.runs import Run, largest, make_run
from flowbothd_evaluation.openings.search import Place, PlaceSearch
from flowbothd_evaluation.openings.task import Opening, key_of
from flowbothd_evaluation.records import OpeningRecord
from flowbothd_evaluation.resumable import run_resumable

CHUNK = 100
FINALISTS = 4
SEEDS = 2
_APART = 0.06
_APART_DEG = 20.0


@dataclass(frozen=True)
class Chunk:
    """Some places of one task to judge."""

    opening: Opening
    number: int


@dataclass(frozen=True)
class PlacesRecord:
    """What came of a chunk: its best places."""

    KIND: ClassVar[str] = "places"

    task: str
    chunk: int
    places: tuple[Place, ...]

    @property
    def key(self) -> tuple[str, int]:
        """By which the record of a chunk is found again."""
        return self.task, self.chunk


def search(openings: dict[str, Opening], places: int, out: Path, jobs: int) -> str:
    """Judge `places` random places of each task, simulate the best; Markdown, best first.

    Args:
        openings: Tasks by name; their own poses are not looked at.
        places: How many to draw for each.
        out: JSON lines; two files beside it are written, and continued.
        jobs: Processes.
    """
    count = -(-places // CHUNK)
    work = {(n, k): Chunk(o, k) for n, o in openings.items() for k in range(count)}
    judged = run_resumable(
        work, _judge, PlacesRecord, out.with_suffix(".places.jsonl"), jobs, unit="chunk"
    )
    finalists = {name: _finalists(name, judged) for name in openings}
    runs = {
        key_of(standing, seed): Run(standing, seed, None)
        for name, opening in openings.items()
        for place in finalists[name]
        for standing in [place.of(opening)]
        for seed in range(SEEDS)
    }
    file = out.with_suffix(".finalists.jsonl")
    records = run_resumable(runs, make_run, OpeningRecord, file, jobs, unit="run")
    parts = [_ranking(openings[name], finalists[name], records) for name in openings]
    return "\n\n".join(parts)


def _judge(chunk: Chunk) -> PlacesRecord:
    best = PlaceSearch(chunk.opening).best(CHUNK, chunk.number, 3 * FINALISTS)
    good = tuple(place for place in best if place.reached >= 1)
    return PlacesRecord(chunk.opening.name, chunk.number, good)


def _finalists(task: str, judged: Sequence[PlacesRecord]) -> list[Place]:
    """The best places that differ from each other."""
    places = [place for record in judged if record.task == task for place in record.places]
    chosen: list[Place] = []
    for place in sorted(places, key=lambda p: -p.score):
        if len(chosen) < FINALISTS and all(_differ(place, other) for other in chosen):
            chosen.append(place)
    return chosen


def _differ(one: Place, other: Place) -> bool:
    apart = np.hypot(*np.subtract(one.position, other.position))
    return bool(apart > _APART or abs(one.yaw_deg - other.yaw_deg) > _APART_DEG)


_HEAD = (
    *("position", "yaw_deg", "grasp", "opened", "clean", "reached", "peak force [N]"),
    *("joint margin [rad]", "conditioning [m/rad]", "clearance [m]"),
)


def _ranking(opening: Opening, places: Sequence[Place], records: Sequence[OpeningRecord]) -> str:
    scale, _ = opening.shown_in
    rows = []
    for place in places:
        at = key_of(place.of(opening), 0)[2]
        runs = [r for r in records if r.task == opening.name and r.at == at]
        opened, clean = sum(r.opened for r in runs), sum(r.clean for r in runs)
        both = sum(r.opened and r.clean for r in runs)
        cells = (
            *(list(place.position), f"{place.yaw_deg:g}", list(place.grasp), opened, clean),
            f"{scale * min(r.reached for r in runs):.1f}",
            f"{largest(r.peak_force for r in runs):.0f}",
            *(f"{place.margin:.2f}", f"{place.conditioning:.2f}", f"{place.clearance:.3f}"),
        )
        rows.append(((both, opened, clean, place.score), cells))
    ranked = sorted(rows, key=lambda row: row[0], reverse=True)
    title = f"{opening.name}: best places of the search, {SEEDS} runs each"
    return f"{title}\n\n{markdown_table(_HEAD, [cells for _, cells in ranked])}"
