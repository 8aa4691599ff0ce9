"""`flowbothd bench motion`: random motion requests by the thousand, and what planning costs.

Every request is run to its end against an arm that follows exactly; limits are checked at all
samples and between them. Shards are kept as files, so that a long run can be stopped and resumed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from flowbothd_evaluation.benchmarks.motion_requests import Verdict, draw, run_request
from flowbothd_evaluation.run_record.record import write_json
from franka_suction_driver.arm import trajectory
from franka_suction_driver.arm.kinematics import make_kinematics
from franka_suction_driver.execution import tool_path
from franka_suction_driver.execution.executor import MotionExecutor
from franka_suction_driver.planning import planner, standoff
from franka_suction_driver.planning.collision import CollisionChecker
from franka_suction_driver.simulated import sim_motion_params

SHARD = 100
_BUDGETS = {
    "probe": (None, 20.0),
    "flow_step": (None, 20.0),
    "approach": (150.0, 1000.0),
    "retreat": (150.0, 1000.0),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd bench motion`."""
    parser.add_argument("--requests", type=int, default=1000, help="(default: %(default)s)")
    parser.add_argument(
        "--timed", type=int, default=300, help="requests of the timing split (default: %(default)s)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/bench_motion"),
        help="folder of the shards; those that are there are not run again (default: %(default)s)",
    )
    parser.add_argument("--json", type=Path, default=None, metavar="FILE", help="write figures too")


def run(arguments: argparse.Namespace) -> int:
    """Run the shards that are missing, then print what all of them say."""
    verdicts = list(_sharded(arguments.requests, arguments.out))
    split = _timing_split(arguments.timed)
    summary = {"requests": summarise(verdicts), "planning_split": split}
    sys.stdout.write(f"{_requests_table(verdicts)}\n\n{_split_table(split)}\n")
    if arguments.json is not None:
        write_json(arguments.json, summary)
    faults = [v for v in verdicts if v.fault]
    for verdict in faults[:10]:
        sys.stdout.write(f"{verdict.kind}: {verdict.fault}\n")
    return 1 if faults else 0


def summarise(verdicts: Sequence[Verdict]) -> dict[str, dict[str, Any]]:
    """Figures by kind of motion; times in milliseconds of the planning thread."""
    result: dict[str, dict[str, Any]] = {}
    for kind in sorted({v.kind for v in verdicts}):
        some = [v for v in verdicts if v.kind == kind]
        planned = [v for v in some if v.trajectories] or some
        times = 1e3 * np.array([v.planning for v in planned])
        walls = 1e3 * np.array([v.wall for v in planned])
        result[kind] = {
            "requests": len(some),
            "faults": sum(bool(v.fault) for v in some),
            "largest_ratio_between_samples": round(max(v.fine_ratio for v in some), 4),
            "largest_end_speed": max(v.end_speed for v in some),
            "largest_bend_mm": round(1e3 * max(v.bend for v in some), 3),
            "planning_median_ms": round(float(np.median(times)), 2),
            "planning_p99_ms": round(float(np.percentile(times, 99)), 2),
            "wall_median_ms": round(float(np.median(walls)), 2),
            "wall_p99_ms": round(float(np.percentile(walls, 99)), 2),
            "reasons": dict(Counter(v.reason for v in some).most_common()),
        }
    return result


def run_shard(seed: int, count: int, step: Callable[[], object] = lambda: None) -> list[Verdict]:
    """`count` requests with an executor and random numbers of their own."""
    params = sim_motion_params()
    executor = MotionExecutor(make_kinematics(params), params, seed)
    rng = np.random.default_rng([20, seed])
    verdicts = []
    for _ in range(count):
        executor.set_obstacles(None)
        verdicts.append(run_request(executor, draw(executor, rng)))
        step()
    return verdicts


def _sharded(requests: int, folder: Path) -> Iterator[Verdict]:
    folder.mkdir(parents=True, exist_ok=True)
    counts = [min(SHARD, requests - first) for first in range(0, requests, SHARD)]
    with tqdm(total=requests, unit="request") as bar:
        for seed, count in enumerate(counts):
            file = folder / f"shard-{seed:03d}-{count}.json"
            if file.exists():
                bar.update(count)
            else:
                entries = [v.entry() for v in run_shard(seed, count, bar.update)]
                part = file.with_suffix(f".{os.getpid()}.part")
                part.write_text(json.dumps(entries))
                part.replace(file)
            yield from (Verdict(**entry) for entry in json.loads(file.read_text()))


class _Stopwatch:
    """Adds up the time spent in named parts; of nested parts the outermost counts."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self._inside = ""

    def wrapped(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any, **keywords: Any) -> Any:
            if self._inside:
                return function(*arguments, **keywords)
            self._inside = name
            began = time.thread_time()
            try:
                return function(*arguments, **keywords)
            finally:
                self.spent[name] = self.spent.get(name, 0.0) + time.thread_time() - began
                self._inside = ""

        return timed


@contextmanager
def _watched(stopwatch: _Stopwatch) -> Iterator[None]:
    """Time IK, Ruckig and collision checks wherever planning calls them."""
    parts: tuple[tuple[str, Any, str], ...] = (
        ("IK", standoff, "solve"),
        ("IK", standoff, "follow"),
        ("IK", planner, "follow"),
        ("IK", tool_path, "_stepped"),
        ("Ruckig", trajectory, "_solve"),
        ("Ruckig", trajectory.Profile, "sample"),
        ("Ruckig", trajectory.Profile, "at"),
        ("collision", CollisionChecker, "free"),
        ("collision", CollisionChecker, "touch"),
        ("collision", CollisionChecker, "touches"),
        ("collision", CollisionChecker, "edge_free"),
    )
    kept = [(owner, name, getattr(owner, name)) for _, owner, name in parts]
    try:
        for part, owner, name in parts:
            setattr(owner, name, stopwatch.wrapped(part, getattr(owner, name)))
        yield
    finally:
        for owner, name, function in kept:
            setattr(owner, name, function)


def _timing_split(count: int) -> dict[str, dict[str, float]]:
    """Share of planning's time by part and kind, from requests of a shard of their own."""
    params = sim_motion_params()
    executor = MotionExecutor(make_kinematics(params), params, 0)
    rng = np.random.default_rng([21, 0])
    totals: dict[str, dict[str, float]] = {}
    for _ in range(count):
        executor.set_obstacles(None)
        request = draw(executor, rng)
        stopwatch = _Stopwatch()
        with _watched(stopwatch):
            verdict = run_request(executor, request, only_planning=True)
        total = totals.setdefault(verdict.kind, {"all": 0.0})
        total["all"] += verdict.planning
        for part, spent in stopwatch.spent.items():
            total[part] = total.get(part, 0.0) + spent
    return {
        kind: {
            part: round(spent / total["all"], 3) for part, spent in total.items() if total["all"]
        }
        for kind, total in totals.items()
    }


def _requests_table(verdicts: Sequence[Verdict]) -> str:
    lines = [
        "| motion | requests | faults | worst limit between samples | end speed [rad/s] "
        "| bend [mm] | planning median [ms] | p99 [ms] | p99 allowed [ms] | ended by |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for kind, row in summarise(verdicts).items():
        reasons = ", ".join(f"{name} {count}" for name, count in row["reasons"].items())
        lines.append(
            f"| {kind} | {row['requests']} | {row['faults']} "
            f"| {row['largest_ratio_between_samples']:.3f} | {row['largest_end_speed']:g} "
            f"| {row['largest_bend_mm']:.2f} | {row['planning_median_ms']:.1f} "
            f"| {row['planning_p99_ms']:.1f} | {_BUDGETS[kind][1]:.0f} | {reasons} |"
        )
    return "\n".join(lines)


def _split_table(split: dict[str, dict[str, float]]) -> str:
    lines = ["| motion | IK | Ruckig | collision | rest |", "|---|---|---|---|---|"]
    for kind, parts in sorted(split.items()):
        shares = [parts.get(name, 0.0) for name in ("IK", "Ruckig", "collision")]
        cells = " | ".join(f"{100 * share:.0f} %" for share in (*shares, 1 - sum(shares)))
        lines.append(f"| {kind} | {cells} |")
    return "\n".join(lines)
