"""`flowbothd eval`: the paper's experiment, one record for every object, link and trial."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from flowbothd_common.errors import ObjectModelError, ParameterError
from flowbothd_common.types import Outcome
from flowbothd_evaluation.paper.cases import Case, find_cases
from flowbothd_evaluation.paper.methods import (
    METHODS,
    POLICIES,
    every_combination,
    method,
    parse_switches,
    weights_digest,
    weights_of,
)
from flowbothd_evaluation.paper.suites import SUITES, Row, Suite
from flowbothd_evaluation.paper.tables import RowKey, row_key
from flowbothd_evaluation.paper.trial import MASKS, NONE, EvalTrial, failed, record_key, run_trial
from flowbothd_evaluation.resumable import Record, add_work_arguments, read_records, run_resumable

FILTER = Row("oracle", ("SG",), "robot")
"""Who decides what can be opened at all: the truth, with the policy that makes the most of it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd eval`."""
    add = parser.add_argument
    add(
        "--objects",
        nargs="+",
        required=True,
        metavar="DIR",
        help="object folders, folders of such, procedural:test, or procedural:test:N for N of each "
        "category",
    )
    add(
        "--ids", default="", metavar="A,B", help="only these objects (default: all, or the suite's)"
    )
    add(
        "--links",
        choices=("openable", "all"),
        default="openable",
        help="those that the paper's authors could open with the truth, where that is known, or "
        "every one with a range (default: %(default)s)",
    )
    add(
        "--method",
        nargs="+",
        default=[],
        metavar="NAME",
        help=f"any of {', '.join(METHODS)}; flowbothd* and flowbot3d* run our compact* weights, "
        "one-step models trained by implicit maximum likelihood instead of the paper's diffusion "
        "chains, unless --weights names others",
    )
    add(
        "--switches",
        nargs="+",
        default=[],
        metavar="SG+CC+HF",
        help="parts of the policy that are on: any joined by +, none, or all for every combination "
        "(default: the method's best row in the paper)",
    )
    add(
        "--policy",
        choices=POLICIES,
        default=POLICIES[0],
        help="the paper's algorithm, or with what the robot's policy adds (default: %(default)s)",
    )
    add(
        "--target-mask",
        nargs="+",
        choices=MASKS,
        default=[MASKS[0]],
        help="truth: only the target link may be grasped, one record a link; none: the whole "
        "cloud, one record an object (default: %(default)s)",
    )
    add("--suite", choices=tuple(SUITES), help="objects, methods and trials of a committed suite")
    add(
        "--weights",
        nargs="+",
        default=[],
        metavar="METHOD=PATH",
        help="other weights for a method than "
        + ", ".join(f"{m.name}={m.weights}" for m in METHODS.values() if m.weights),
    )
    add("--trials", type=int, help="repetitions (default: 5, or the suite's)")
    add("--steps", type=int, default=30, help="pulls in a trial (default: %(default)s)")
    add("--seed", type=int, default=0, help="of everything (default: %(default)s)")
    add(
        "--no-filter",
        action="store_true",
        help="try links, too, that the truth does not open",
    )
    add_work_arguments(parser, Path("out/eval/results.jsonl"))


def run(arguments: argparse.Namespace) -> int:
    """Run what is missing, and say how it went."""
    chosen = SUITES[arguments.suite] if arguments.suite else None
    rows = _rows(arguments, chosen)
    trials = chosen.trials if chosen else 5
    trials = trials if arguments.trials is None else arguments.trials
    for name, value in (("--trials", trials), ("--steps", arguments.steps)):
        if value < 1:
            raise ParameterError(name, got=value, allowed=">= 1")
    cases = _cases(arguments, chosen.ids if chosen else ())
    weights = _weights(arguments.weights, rows)
    read_records(arguments.out)
    work = {
        trial.key(): trial
        for row in rows
        for trial in _trials(row, cases, trials, weights, arguments)
    }
    opened: Mapping[Hashable, Record] = {}
    if not arguments.no_filter:
        opened = _filtered(cases, arguments)
    records = _evaluate(work, opened, arguments)
    _tell(records)
    return 0


def _rows(arguments: argparse.Namespace, chosen: Suite | None) -> list[Row]:
    if chosen:
        if arguments.method or arguments.switches:
            raise ParameterError(
                "a suite has its own methods and switches",
                got=f"--suite {arguments.suite} with --method or --switches",
                hint="leave out one of them",
            )
        return list(chosen.rows)
    masks = tuple(dict.fromkeys(arguments.target_mask))
    rows = []
    for name in dict.fromkeys(arguments.method or ["flowbothd"]):
        wanted = [method(name).switches]
        if arguments.switches == ["all"]:
            wanted = every_combination()
        elif arguments.switches:
            wanted = [parse_switches(text) for text in arguments.switches]
        rows += [Row(name, switches, arguments.policy, masks) for switches in wanted]
    return rows


class _Weights(NamedTuple):
    """Name or path, empty for none, and hash of the file."""

    name: str = ""
    digest: str = ""


def _weights(given: Sequence[str], rows: Sequence[Row]) -> dict[str, _Weights]:
    """Weights by method, all of them there: better told now than after an hour."""
    changed = {}
    for text in given:
        name, separator, path = text.partition("=")
        if not separator or name not in METHODS:
            raise ParameterError(
                "weights for a method", got=text, allowed=f"METHOD=PATH, METHOD of {list(METHODS)}"
            )
        changed[name] = path
    found = {row.method: weights_of(METHODS[row.method], changed) for row in rows}
    return {chosen: _Weights(name, weights_digest(name)) for chosen, name in found.items()}


def _cases(arguments: argparse.Namespace, ids: Sequence[str]) -> list[Case]:
    wanted = arguments.ids.split(",") if arguments.ids else ids
    cases = find_cases(arguments.objects, wanted)
    if arguments.links == "all":
        cases = [replace(case, openable=case.links) for case in cases]
    if not any(case.openable for case in cases):
        raise ObjectModelError(
            "none of the objects has a link to open",
            got=", ".join(case.name for case in cases),
            hint="--links all takes those, too, that the paper's authors could not open",
        )
    return cases


def _trials(
    row: Row,
    cases: Sequence[Case],
    trials: int,
    weights: Mapping[str, _Weights],
    arguments: argparse.Namespace,
) -> Iterator[EvalTrial]:
    name, digest = weights.get(row.method, _Weights())
    for mask in row.masks:
        for case in cases:
            links = case.openable if mask != NONE else ("",) * bool(case.openable)
            for link in links:
                for number in range(trials):
                    yield EvalTrial(
                        case,
                        link,
                        number,
                        row.method,
                        row.switches,
                        row.policy,
                        name,
                        arguments.steps,
                        arguments.seed,
                        digest,
                    )


def _filtered(cases: Sequence[Case], arguments: argparse.Namespace) -> dict[Hashable, Record]:
    """The ground-truth filter: its records by object and link, kept beside the results."""
    work = {trial.key(): trial for trial in _trials(FILTER, cases, 1, {}, arguments)}
    out = arguments.out.parent / "ground_truth_filter.jsonl"
    records = run_resumable(work, run_trial, record_key, out, arguments.jobs, unit="link")
    shut = [f"{r['object']} {r['link']} ({r['outcome']})" for r in records if not r["success"]]
    sys.stdout.write(
        f"ground truth opens {len(records) - len(shut)} of {len(records)} links"
        + (f"; not {', '.join(shut)}" if shut else "")
        + "\n"
    )
    return {(r["object"], r["link"]): r for r in records}


def _evaluate(
    work: Mapping[Hashable, EvalTrial],
    opened: Mapping[Hashable, Record],
    arguments: argparse.Namespace,
) -> list[Record]:
    """Run the trials; those of links that the truth cannot open are recorded as such."""
    shut = {key for key, record in opened.items() if not record["success"]}
    plan = {key: (trial, _hopeless(trial, shut)) for key, trial in work.items()}
    return run_resumable(plan, _run, record_key, arguments.out, arguments.jobs)


def _hopeless(trial: EvalTrial, shut: set[Hashable]) -> bool:
    links = (trial.link,) if trial.link else trial.case.openable
    return all((trial.case.name, link) in shut for link in links)


def _run(planned: tuple[EvalTrial, bool]) -> Record:
    trial, hopeless = planned
    if not hopeless:
        return run_trial(trial)
    reason = "the ground-truth filter did not open it either"
    nothing = failed(trial.link, Outcome.UNOPENABLE_WITH_GROUND_TRUTH, reason)
    return {**trial.identity(), **nothing, "seconds": {"total": 0.0}}


def _tell(records: Sequence[Record]) -> None:
    """One line a row; `flowbothd tables` has the rest."""
    rows: dict[RowKey, list[Record]] = {}
    for record in records:
        rows.setdefault(row_key(record), []).append(record)
    for (name, switches, policy, mask), found in rows.items():
        opened = sum(bool(r["success"]) for r in found)
        sys.stdout.write(
            f"{name} [{switches or 'none'}] {policy} policy, target mask {mask}: "
            f"{opened} of {len(found)} opened\n"
        )
