"""Timing as medians and 99th percentiles, with ratios to a baseline of the same run."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from flowbothd_common.markdown import markdown_table
from flowbothd_evaluation.record_files import write_json


@dataclass(frozen=True)
class Timing:
    """Durations of one operation [s].

    Attributes:
        median: Half of the repetitions were faster.
        p99: All but one in a hundred were faster.
        repetitions: How many.
    """

    median: float
    p99: float
    repetitions: int


def measure(
    operations: Mapping[str, Callable[[], object]], repetitions: int, warm_up: int = 2
) -> dict[str, Timing]:
    """Time several operations, interleaved, so that a busy moment of the machine hits them all."""
    for _ in range(warm_up):
        for operation in operations.values():
            operation()
    samples: dict[str, list[float]] = {name: [] for name in operations}
    for _ in range(repetitions):
        for name, operation in operations.items():
            began = time.perf_counter()
            operation()
            samples[name].append(time.perf_counter() - began)
    return {
        name: Timing(float(np.median(s)), float(np.percentile(s, 99)), repetitions)
        for name, s in samples.items()
    }


def timing_table(timings: Mapping[str, Timing], baseline: str) -> str:
    """Markdown table in milliseconds, with the ratio of every median to the baseline's."""
    base = timings[baseline].median
    rows = [
        (
            name,
            f"{1e3 * t.median:.3f}",
            f"{1e3 * t.p99:.3f}",
            f"{base / t.median:.2f}",
            t.repetitions,
        )
        for name, t in timings.items()
    ]
    head = ("operation", "median [ms]", "p99 [ms]", "baseline / median", "repetitions")
    return markdown_table(head, rows)


def add_json_argument(parser: argparse.ArgumentParser) -> None:
    """The argument that every benchmark shares."""
    parser.add_argument("--json", type=Path, default=None, metavar="FILE", help="write figures too")


def write_timings(path: Path | None, timings: Mapping[str, Timing], **more: object) -> None:
    """Write the figures as JSON if a path was given."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, {"timings": {n: asdict(t) for n, t in timings.items()}, **more})
