"""`flowbothd bench openings --search`: places judged by kinematics, the best of them simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flowbothd_evaluation.openings.runs import Run, key_of, make_run, peak, record_key
from flowbothd_evaluation.openings.search import Place, PlaceSearch
from flowbothd_evaluation.openings.task import Opening
from flowbothd_evaluation.resumable import Record, run_resumable

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
        work, _judge, _chunk_key, out.with_suffix(".places.jsonl"), jobs, unit="chunk"
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
    records = run_resumable(runs, make_run, record_key, file, jobs, unit="run")
    parts = [_ranking(openings[name], finalists[name], records) for name in openings]
    return "\n\n".join(parts)


def _judge(chunk: Chunk) -> Record:
    best = PlaceSearch(chunk.opening).best(CHUNK, chunk.number, 3 * FINALISTS)
    good = [asdict(place) for place in best if place.reached >= 1]
    return {"task": chunk.opening.name, "chunk": chunk.number, "places": good}


def _chunk_key(record: Record) -> tuple[str, int]:
    return record["task"], record["chunk"]


def _finalists(task: str, judged: Sequence[Record]) -> list[Place]:
    """The best places that differ from each other."""
    entries = [entry for record in judged if record["task"] == task for entry in record["places"]]
    places = [_place(entry) for entry in entries]
    chosen: list[Place] = []
    for place in sorted(places, key=lambda p: -p.score):
        if len(chosen) < FINALISTS and all(_differ(place, other) for other in chosen):
            chosen.append(place)
    return chosen


def _place(entry: dict[str, Any]) -> Place:
    pairs = {name: tuple(entry[name]) for name in ("position", "grasp")}
    return Place(**{**entry, **pairs})


def _differ(one: Place, other: Place) -> bool:
    apart = np.hypot(*np.subtract(one.position, other.position))
    return bool(apart > _APART or abs(one.yaw_deg - other.yaw_deg) > _APART_DEG)


def _ranking(opening: Opening, places: Sequence[Place], records: Sequence[Record]) -> str:
    lines = [
        f"{opening.name}: best places of the search, {SEEDS} runs each",
        "",
        "| position | yaw_deg | grasp | opened | clean | reached | peak force [N] "
        "| joint margin [rad] | conditioning [m/rad] | clearance [m] |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    scale, _ = opening.shown_in
    rows = []
    for place in places:
        key = key_of(place.of(opening), 0)[2]
        runs = [r for r in records if r["task"] == opening.name and tuple(r["at"]) == key]
        opened, clean = sum(r["opened"] for r in runs), sum(r["clean"] for r in runs)
        both = sum(r["opened"] and r["clean"] for r in runs)
        least = min(r["reached"] for r in runs)
        text = (
            f"| {list(place.position)} | {place.yaw_deg:g} | {list(place.grasp)} | {opened} "
            f"| {clean} | {scale * least:.1f} "
            f"| {peak(runs, 'peak_force'):.0f} | {place.margin:.2f} | {place.conditioning:.2f} "
            f"| {place.clearance:.3f} |"
        )
        rows.append((both, opened, clean, place.score, text))
    return "\n".join(lines + [row[-1] for row in sorted(rows, reverse=True)])
