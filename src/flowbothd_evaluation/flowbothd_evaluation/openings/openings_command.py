"""`flowbothd eval openings`: how far each part is opened from its committed pose, run by run.

Runs are stepped and repeat bit for bit; each is one JSON record, so that a long bench can be
stopped and resumed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from flowbothd_evaluation.openings.runs import Run, make_run, strip_file, table
from flowbothd_evaluation.openings.search_command import search
from flowbothd_evaluation.openings.task import key_of, load_openings
from flowbothd_evaluation.records import OpeningRecord
from flowbothd_evaluation.resumable import add_work_arguments, run_resumable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd eval openings`."""
    parser.add_argument("--tasks", nargs="*", default=[], metavar="TASK", help="(default: all)")
    parser.add_argument("--seeds", type=int, default=10, help="runs each (default: %(default)s)")
    add_work_arguments(parser, Path("out/eval/openings.jsonl"), "run")
    parser.add_argument(
        "--search",
        type=int,
        default=0,
        metavar="PLACES",
        help="look for poses instead: judge so many random ones of each task, simulate the best",
    )
    parser.add_argument(
        "--frames", type=Path, default=None, metavar="DIR", help="write pictures of new runs there"
    )


def run(arguments: argparse.Namespace) -> int:
    """Make the runs that are missing and print the table; 1 if a task falls short."""
    openings = load_openings(arguments.tasks)
    if arguments.search:
        found = search(openings, arguments.search, arguments.out, arguments.jobs)
        sys.stdout.write(found + "\n")
        return 0
    work = {
        key_of(opening, seed): Run(opening, seed, arguments.frames)
        for opening in openings.values()
        for seed in range(arguments.seeds)
    }
    records = run_resumable(
        work, make_run, OpeningRecord, arguments.out, arguments.jobs, unit="run"
    )
    sys.stdout.write(table(openings, records) + "\n")
    if arguments.frames is not None:
        _overview(list(openings), arguments.frames)
    return 0 if all(r.opened and r.clean for r in records) else 1


def _overview(tasks: list[str], folder: Path) -> None:
    from flowbothd_evaluation.openings.strip import save_overview

    files = {task: strip_file(folder, task, 0) for task in tasks}
    there = {task: file for task, file in files.items() if file.exists()}
    if there:
        save_overview(there, folder / "overview.png")
