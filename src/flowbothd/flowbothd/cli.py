"""The `flowbothd` command.

Every subcommand lives in a module with `add_arguments(parser)` and `run(arguments) -> exit status`;
modules are imported only when their command runs, so that `--help` is immediate and a missing
optional dependency hurts only the command that needs it.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from flowbothd_common.errors import FlowBotError
from flowbothd_common.versions import versions


@dataclass(frozen=True)
class Command:
    """One subcommand.

    Attributes:
        name: Words of the command, such as ``bench sim``.
        module: Module with add_arguments and run.
        summary: One line for the list.
        examples: Shown at the end of its help.
        for_robot: It works with hardware, and says first that none has been tried.
    """

    name: str
    module: str
    summary: str
    examples: tuple[str, ...] = ()
    for_robot: bool = False


NOT_TRIED = "not yet tried on hardware: so far only simulated and mock devices have been connected"
"""Printed once by every command for a robot, until a lab has opened something."""

COMMANDS = (
    Command(
        "demo",
        "flowbothd.demo",
        "a simulated Panda opens an object through all nodes; writes a report",
        ("flowbothd demo --seed 3", "flowbothd demo --object drawer --predictor oracle"),
    ),
    Command(
        "up sim",
        "flowbothd.up",
        "start all nodes against the simulation and leave them running",
        ("flowbothd up sim --object custom_door --start", "flowbothd up sim --object ~/8994"),
    ),
    Command(
        "record",
        "flowbothd.record_command",
        "record a running graph as a rosbag2 folder (mcap)",
        (
            "flowbothd record --out bags/kitchen",
            "flowbothd record --profile all --domain 7",
            "flowbothd record --recover bags/kitchen",
        ),
    ),
    Command(
        "replay",
        "flowbothd.replay.replay_command",
        "play a recording to nodes, or recompute their output and compare",
        (
            "flowbothd replay out/demo/bag --rate 2 --from 5 --to 20",
            "flowbothd replay out/demo/bag --recompute policy",
            "flowbothd replay out/demo/bag --recompute perception,inference,policy",
            "flowbothd replay rosbag2_2026_01_01-12_00_00 --nodes perception",
        ),
    ),
    Command(
        "view",
        "flowbothd.view.view_command",
        "everything of a run in Rerun, live or from a recording",
        (
            "flowbothd view out/demo/bag",
            "flowbothd view live --domain 7",
            "flowbothd view out/demo/bag --save demo.rrd",
        ),
    ),
    Command(
        "report",
        "flowbothd.report.report_command",
        "write a page with pictures and figures of a recording",
        ("flowbothd report out/demo/bag", "flowbothd report bags/kitchen --out kitchen"),
    ),
    Command(
        "up robot",
        "flowbothd.up_robot",
        "start all nodes on a robot and leave them running; docs/tutorials/own_robot.md",
        (
            "flowbothd up robot --robot 172.16.0.2 --params lab.yaml --dry-run",
            "flowbothd up robot --backend mock --params lab.yaml",
        ),
        for_robot=True,
    ),
    Command(
        "doctor",
        "flowbothd.doctor.doctor",
        "check robot, pump, camera and calibration; says how to fix failed checks",
        ("flowbothd doctor --robot 172.16.0.2 --params lab.yaml",),
        for_robot=True,
    ),
    Command(
        "calibrate",
        "flowbothd.calibrate",
        "find out where the camera is, from the tool or a printed board; or check it",
        (
            "flowbothd calibrate tool --captures out/cal --record 10 --guess 0.5 -1.1 0.7 0.5 0 0.2"
            " --out camera.yaml",
            "flowbothd calibrate board --captures out/cal --record 10 --board 9x6 --square 0.025",
            "flowbothd calibrate check --captures out/check --record 4 --parameters camera.yaml",
        ),
        for_robot=True,
    ),
    Command(
        "trials",
        "flowbothd_evaluation.trials",
        "open objects many times in the stepped world and print the table of successes",
        ("flowbothd trials --suite door --seeds 5", "flowbothd trials --suite furniture"),
    ),
    Command(
        "eval",
        "flowbothd_evaluation.paper.eval_command",
        "the paper's experiment: objects, links and trials by the floating gripper; resumable",
        (
            "flowbothd eval --objects PARTNET/test --method flowbothd oracle",
            "flowbothd eval --objects procedural:test --method flowbothd --switches all",
            "flowbothd eval --suite small --objects PARTNET/train PARTNET/raw/8994"
            " --out out/eval/small.jsonl",
        ),
    ),
    Command(
        "tables",
        "flowbothd_evaluation.paper.tables_command",
        "the paper's tables and figures of evaluation records, as one report",
        (
            "flowbothd tables out/eval/small.jsonl",
            "flowbothd tables out/eval/*.jsonl --out out/report --objects PARTNET/train",
        ),
    ),
    Command(
        "train",
        "flowbothd_model.training.train",
        "train a network; resumable",
        ("flowbothd train --preset compact --data procedural --out runs/compact",),
    ),
    Command(
        "bench model",
        "flowbothd_model.benchmark",
        "time the networks and samplers",
        ("flowbothd bench model --json out/bench_model.json",),
    ),
    Command(
        "bench perception",
        "flowbothd_evaluation.benchmarks.bench_perception",
        "time perception, feed its node at camera rate, compare every pixel with the truth",
        (
            "flowbothd bench perception --json out/bench_perception.json",
            "flowbothd bench perception --seconds 0 --truth 200",
        ),
    ),
    Command(
        "bench record",
        "flowbothd_evaluation.benchmarks.bench_record",
        "record depth images and clouds at camera rate: losses, CPU share, bytes",
        ("flowbothd bench record --json out/bench_record.json",),
    ),
    Command(
        "bench motion",
        "flowbothd_evaluation.benchmarks.bench_motion",
        "random motion requests: limits, straightness, planning times; resumable",
        ("flowbothd bench motion --requests 10000 --json out/bench_motion.json",),
    ),
    Command(
        "bench openings",
        "flowbothd_evaluation.benchmarks.bench_openings",
        "how far the arm opens each part from its committed pose, breaks and touches; resumable",
        (
            "flowbothd bench openings --tasks pull_left drawer --seeds 3 --frames out/openings",
            "flowbothd bench openings --tasks drawer --search 1000 --out out/search.jsonl",
        ),
    ),
    Command(
        "bench sim",
        "flowbothd_evaluation.benchmarks.bench_sim",
        "time the simulation: camera, physics, motion, whole rollouts",
        ("flowbothd bench sim --json out/bench_sim.json",),
    ),
    Command(
        "completion",
        "flowbothd.completion",
        "print a script that lets the shell complete this command",
        (
            "flowbothd completion bash > ~/.local/share/bash-completion/completions/flowbothd",
            "flowbothd completion zsh > ~/.flowbothd_completion  # and source it in ~/.zshrc",
        ),
    ),
)


class _Version(argparse.Action):
    """Prints versions and ends; looks them up only when asked."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        sys.stdout.write("".join(f"{name} {found}\n" for name, found in versions().items()))
        parser.exit()


def _parser(chosen: str | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="flowbothd", description="Opens articulated objects that it has never seen."
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="versions of what matters")
    groups = {"": parser.add_subparsers(dest="command", metavar="COMMAND", required=True)}
    for command in COMMANDS:
        first, _, second = command.name.partition(" ")
        if second and first not in groups:
            words = ", ".join(c.name for c in COMMANDS if c.name.startswith(first + " "))
            parent = groups[""].add_parser(first, help=words, description=words)
            groups[first] = parent.add_subparsers(dest="second", metavar="WHAT", required=True)
        target = groups[first] if second else groups[""]
        examples = "\n".join(("examples:", *(f"  {e}" for e in command.examples)))
        sub = target.add_parser(
            second or first,
            help=command.summary,
            description=f"{command.summary} ({NOT_TRIED})"
            if command.for_robot
            else command.summary,
            epilog=examples if command.examples else None,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        sub.set_defaults(module=command.module, for_robot=command.for_robot)
        if command.name == chosen:
            importlib.import_module(command.module).add_arguments(sub)
    return parser


def _chosen(arguments: Sequence[str]) -> str | None:
    for command in COMMANDS:
        if list(arguments[: len(command.name.split())]) == command.name.split():
            return command.name
    return None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status: 0 success, 1 no success, 2 bad input."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    # ROS looks its plugins up when rclpy is imported, which subcommands do.
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    parsed = _parser(_chosen(given)).parse_args(given)
    if parsed.for_robot:
        sys.stdout.write(f"{NOT_TRIED}\n")
        sys.stdout.flush()
    try:
        return int(importlib.import_module(parsed.module).run(parsed))
    except FlowBotError as error:
        sys.stderr.write(f"flowbothd: {error}\n")
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    raise SystemExit(main())
