"""`flowbothd bench motion`: random motion requests by the thousand, and what planning costs.

Every request is run to its end against an arm that follows exactly; limits are checked at all
samples and between them. Shards are kept as files, so that a long run can be stopped and resumed.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from tqdm import tqdm

from flowbothd_common.markdown import markdown_table
from flowbothd_evaluation.benchmarks.motion_requests import Verdict, draw, run_request
from flowbothd_evaluation.record_files import write_json
from franka_suction_driver.arm.kinematics import make_kinematics
from franka_suction_driver.execution.executor import MotionExecutor
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


_PARTS = {
    "inverse kinematics": (
        "franka_suction_driver.planning.inverse_kinematics",
        "franka_suction_driver.execution.local_ik",
    ),
    "timing": ("franka_suction_driver.arm.trajectory",),
    "collision": ("franka_suction_driver.planning.collision",),
}
"""Parts of planning and the modules that make them up; of nested parts the outermost counts."""

_PLANNING = "franka_suction_driver.execution.executor"
"""Module through which all planning is asked for."""

_SAMPLING = 1e-3
"""Processor time between two looks at what planning is doing [s]; kernels may round it up."""


class _Sampler:
    """Counts in which part of planning the processor's time is spent, by looking now and then.

    The planner runs as in the nodes: nothing of it is replaced, and a look costs it a few
    microseconds. The timer runs on between requests, so that no part of a plan is looked at more
    often than another. For the main thread alone, since that is where Python handles signals.

    Attributes:
        looks: By kind of motion and part.
        kind: Of the motion that is being planned.
    """

    def __init__(self) -> None:
        self.looks: dict[str, Counter[str]] = {}
        self.kind = ""
        self._part_of = {module: part for part, modules in _PARTS.items() for module in modules}

    def __enter__(self) -> _Sampler:
        self._before = signal.signal(signal.SIGPROF, self._look)
        signal.setitimer(signal.ITIMER_PROF, _SAMPLING, _SAMPLING)
        return self

    def __exit__(self, *_: object) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, self._before)

    def _look(self, _: int, frame: FrameType | None) -> None:
        found, planning = "rest", False
        while frame is not None:
            module = frame.f_globals.get("__name__", "")
            found = self._part_of.get(module, found)
            planning |= module == _PLANNING
            frame = frame.f_back
        if planning and self.kind:
            self.looks.setdefault(self.kind, Counter())[found] += 1


def _timing_split(count: int) -> dict[str, dict[str, float]]:
    """Share of planning's time by part and kind, from requests of a shard of their own."""
    params = sim_motion_params()
    executor = MotionExecutor(make_kinematics(params), params, 0)
    rng = np.random.default_rng([21, 0])
    with _Sampler() as sampler:
        for _ in range(count):
            executor.set_obstacles(None)
            sampler.kind = ""
            request = draw(executor, rng)
            sampler.kind = request.goal.kind.value
            run_request(executor, request, only_planning=True)
    return {
        kind: {part: round(looks / total.total(), 3) for part, looks in total.items()}
        for kind, total in sampler.looks.items()
    }


_REQUESTS_HEAD = (
    *("motion", "requests", "faults", "worst limit between samples", "end speed [rad/s]"),
    *("bend [mm]", "planning median [ms]", "p99 [ms]", "p99 allowed [ms]", "ended by"),
)


def _requests_table(verdicts: Sequence[Verdict]) -> str:
    rows = []
    for kind, row in summarise(verdicts).items():
        reasons = ", ".join(f"{name} {count}" for name, count in row["reasons"].items())
        rows.append(
            (
                *(kind, row["requests"], row["faults"]),
                f"{row['largest_ratio_between_samples']:.3f}",
                f"{row['largest_end_speed']:g}",
                f"{row['largest_bend_mm']:.2f}",
                f"{row['planning_median_ms']:.1f}",
                f"{row['planning_p99_ms']:.1f}",
                f"{_BUDGETS[kind][1]:.0f}",
                reasons,
            )
        )
    return markdown_table(_REQUESTS_HEAD, rows)


def _split_table(split: dict[str, dict[str, float]]) -> str:
    rows = []
    for kind, parts in sorted(split.items()):
        shares = [parts.get(name, 0.0) for name in _PARTS]
        rows.append((kind, *(f"{100 * share:.0f} %" for share in (*shares, 1 - sum(shares)))))
    return markdown_table(("motion", *_PARTS, "rest"), rows)
