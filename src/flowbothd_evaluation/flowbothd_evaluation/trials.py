"""`flowbothd trials`: open objects many times in the stepped world, and the table of successes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from flowbothd_common.errors import FlowBotError, ObjectModelError, ParameterError
from flowbothd_common.types import Outcome
from flowbothd_evaluation.resumable import add_work_arguments, run_resumable
from flowbothd_evaluation.run_record.record import as_plain

DOOR_MODES = ("pull_left", "pull_right", "push_left", "push_right")
FURNITURE = ("drawer", "cabinet_door", "lidded_box")
SUITES = ("door", "furniture", "partnet", "all")


@dataclass(frozen=True)
class Trial:
    """One run to make.

    Attributes:
        suite: Which part of the table it belongs to.
        world: arm or floating.
        object: Scene, or path of a PartNet-Mobility folder.
        mode: Mode of the object, or empty.
        target: Target joint, empty = the object's own.
        method: One of METHODS (ambiguous-paper may try failed directions again), or `model:` and
            the name, folder or file of weights.
        seed: Run seed.
    """

    suite: str
    world: str
    object: str
    mode: str
    target: str
    method: str
    seed: int


METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "oracle": ("oracle", {}),
    "ambiguous": ("ambiguous", {}),
    "ambiguous-paper": ("ambiguous", {"reject_failed_directions": False}),
}
"""Method -> predictor, and the policy's parameters that differ from their defaults."""


MODEL = "model:"


def door_trials(methods: Sequence[str], seeds: int) -> Iterator[Trial]:
    """The four-mode door, by the arm."""
    for method in methods:
        for mode in DOOR_MODES:
            for seed in range(seeds):
                yield Trial("door", "arm", "custom_door", mode, "", method, seed)


def furniture_trials(methods: Sequence[str], seeds: int) -> Iterator[Trial]:
    """Procedural furniture, by the arm."""
    for method in methods:
        for name in FURNITURE:
            for seed in range(seeds):
                yield Trial("furniture", "arm", name, "", "", method, seed)


def partnet_trials(folders: Sequence[Path], methods: Sequence[str], seeds: int) -> Iterator[Trial]:
    """Every movable joint of PartNet-Mobility objects, by the floating gripper."""
    from sim_bridge.objects.registry import load_object

    for folder in folders:
        for joint in load_object(folder).joints:
            for method in methods:
                for seed in range(seeds):
                    yield Trial("partnet", "floating", str(folder), "", joint, method, seed)


def run_trial(trial: Trial) -> dict[str, Any]:
    """Run one trial; always a record, whatever happens."""
    try:
        result = _rollout(trial)
    except FlowBotError as error:
        result = {"success": False, "open_ratio": 0.0, "outcome": Outcome.ERROR.value}
        result["reason"] = str(error)
    # The trial's own words come last: by them it is found again after an interruption.
    return {**result, **_identity(trial)}


def _identity(trial: Trial) -> dict[str, Any]:
    return asdict(trial) | {"object": Path(trial.object).name}


def _rollout(trial: Trial) -> dict[str, Any]:
    from flowbothd_evaluation.paper.methods import load_weights

    named = trial.method.startswith(MODEL)
    network = load_weights(trial.method.removeprefix(MODEL)) if named else None
    predictor, changes = METHODS.get(trial.method, ("", {}))
    if trial.world == "floating":
        from flowbothd_evaluation.rollout.floating import FLOATING_POLICY, floating_rollout
        from sim_bridge.objects.registry import load_object

        model = load_object(trial.object, seed=trial.seed)
        model = model.with_target(trial.target) if trial.target else model
        record = floating_rollout(
            model, replace(FLOATING_POLICY, seed=trial.seed, **changes), predictor=network
        )
        return record.summary()
    from flowbothd_evaluation.rollout.arm import arm_rollout
    from sim_bridge.scenes import scene_for

    record, contacts = arm_rollout(
        scene_for(trial.object),
        seed=trial.seed,
        mode=trial.mode,
        predictor=network or predictor,
        policy=changes,
    )
    return record.summary() | {"contacts": as_plain(contacts)}


def _key(entry: dict[str, Any]) -> tuple[Any, ...]:
    names = ("suite", "world", "object", "mode", "target", "method", "seed")
    return tuple(entry[name] for name in names)


def run_trials(trials: Sequence[Trial], out: Path, jobs: int) -> list[dict[str, Any]]:
    """Run the trials that `out` does not hold yet, append their records, and return all of them."""
    wanted = {_key(_identity(trial)): trial for trial in trials}
    return sorted(run_resumable(wanted, run_trial, _key, out, jobs), key=_key)


def table(records: Sequence[dict[str, Any]]) -> str:
    """Markdown table: one row a suite, object, mode or joint and method."""
    rows: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for entry in records:
        part = entry["mode"] or entry["target"]
        rows.setdefault((entry["suite"], entry["object"], entry["method"], part), []).append(entry)
    lines = [
        "| object | mode or joint | method | opened | left open | mean open ratio | steps | grasps "
        "| peak force [N] | arm touched [N] | not opened because |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    totals: dict[tuple[str, ...], list[int]] = {}
    for (suite, name, method, part), entries in rows.items():
        opened = sum(bool(e["success"]) for e in entries)
        total = totals.setdefault((suite, name, method), [0, 0])
        total[0] += opened
        total[1] += len(entries)
        failures = sorted({f"{e['outcome']}: {e['reason']}" for e in entries if not e["success"]})
        lines.append(
            f"| {name} | {part} | {method} | {opened} of {len(entries)} "
            f"| {sum(e.get('open_ratio_left', 0.0) > OPEN for e in entries)} "
            f"| {_mean(entries, 'open_ratio'):.2f} | {_mean(entries, 'steps'):.1f} "
            f"| {_mean(entries, 'grasps'):.1f} "
            f"| {max(float(e.get('peak_force', 0.0)) for e in entries):.0f} "
            f"| {_touched(entries)} "
            f"| {'; '.join(failures)[:160]} |"
        )
    lines += ["", "| object | method | opened |", "|---|---|---|"]
    lines += [f"| {n} | {m} | **{a} of {b}** |" for (_, n, m), (a, b) in totals.items()]
    return "\n".join(lines)


OPEN = 0.9
"""Open ratio above which a part counts as open."""


def _touched(entries: Sequence[dict[str, Any]]) -> str:
    """Runs in which anything but the cup touched object or table, and the largest force."""
    worst = [max(e["contacts"].values()) for e in entries if e.get("contacts")]
    return f"{len(worst)} runs, up to {max(worst):.0f}" if worst else "never"


def _mean(entries: Sequence[dict[str, Any]], key: str) -> float:
    return sum(float(e.get(key, 0.0)) for e in entries) / len(entries)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd trials`."""
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
    add_work_arguments(parser, Path("out/trials.jsonl"))


def run(arguments: argparse.Namespace) -> int:
    """Run the suite and print its table."""
    suite = arguments.suite
    for method in arguments.methods:
        if method not in METHODS and not method.startswith(MODEL):
            raise ParameterError(
                "no such method", got=method, allowed=[*METHODS, f"{MODEL}WEIGHTS"]
            )
    others = arguments.methods or ["oracle"]
    trials: list[Trial] = []
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
