"""`flowbothd eval arm`: open objects many times in the stepped world, and count successes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from flowbothd_common.errors import ObjectModelError, ParameterError
from flowbothd_evaluation.arm.table import table
from flowbothd_evaluation.arm.trials import (
    METHODS,
    MODEL,
    ArmTrial,
    door_trials,
    furniture_trials,
    partnet_trials,
    run_trial,
)
from flowbothd_evaluation.records import ArmRecord
from flowbothd_evaluation.resumable import add_work_arguments, run_resumable

SUITES = ("door", "furniture", "partnet", "all")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd eval arm`."""
    parser.add_argument("--suite", choices=SUITES, default="all", help="(default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=0, help="runs each (default: 5; furniture: 3)")
    parser.add_argument(
        "--methods",
        nargs="+",
        default=[],
        metavar="METHOD",
        help=f"any of {', '.join(METHODS)}, {MODEL}WEIGHTS (default: the first three for the door, "
        "oracle for the rest)",
    )
    parser.add_argument(
        "--objects",
        type=Path,
        nargs="*",
        default=[],
        metavar="FOLDER",
        help="PartNet-Mobility folders of the partnet suite",
    )
    add_work_arguments(parser, Path("out/eval/arm.jsonl"))


def run(arguments: argparse.Namespace) -> int:
    """Run the suite and print its table."""
    suite = arguments.suite
    for method in arguments.methods:
        if method not in METHODS and not method.startswith(MODEL):
            raise ParameterError(
                "no such method", got=method, allowed=[*METHODS, f"{MODEL}WEIGHTS"]
            )
    others = arguments.methods or ["oracle"]
    trials: list[ArmTrial] = []
    if suite in ("door", "all"):
        trials += door_trials(arguments.methods or list(METHODS), arguments.seeds or 5)
    if suite in ("furniture", "all"):
        trials += furniture_trials(others, arguments.seeds or 3)
    if suite == "partnet" and not arguments.objects:
        raise ObjectModelError(
            "the partnet suite needs objects", hint="give --objects FOLDER [FOLDER ...]"
        )
    if suite in ("partnet", "all"):
        trials += partnet_trials(arguments.objects, others, arguments.seeds or 5)
    records = run_trials(trials, arguments.out, arguments.jobs)
    sys.stdout.write(table(records) + "\n")
    return 0


def run_trials(trials: Sequence[ArmTrial], out: Path, jobs: int) -> list[ArmRecord]:
    """Run the trials that `out` does not hold yet, append their records, and return all of them."""
    wanted = {trial.key: trial for trial in trials}
    records = run_resumable(wanted, run_trial, ArmRecord, out, jobs)
    return sorted(records, key=lambda record: record.key)
