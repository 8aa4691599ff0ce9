"""`flowbothd demo`: the whole graph opens one object; summary, pictures and signals in out/demo."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from flowbothd.record_command import complete
from flowbothd.report.report import write_report
from flowbothd.up import add_run_arguments, run_options
from flowbothd.view.view_command import save_bag
from flowbothd_bringup.node_graph import NodeProcess
from flowbothd_bringup.processes import run_graph
from flowbothd_bringup.sim_graph import check_object, sim_graph
from flowbothd_common.environment import node_environment, own_domain
from flowbothd_common.errors import FlowBotError
from flowbothd_evaluation.run_record.record import load_record
from flowbothd_rosbag.reader import Bag
from sim_bridge.scenes import scene_for


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd demo`."""
    add_run_arguments(parser)
    parser.add_argument(
        "--out", type=Path, default=Path("out/demo"), help="output folder (default: %(default)s)"
    )
    parser.add_argument(
        "--timeout",
        type=float,
        default=400.0,
        help="give up after this many seconds of wall time (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run graph and operator; 0 if the object was opened, 1 if not, 2 on bad input."""
    scene = scene_for(arguments.object)
    arguments.out.mkdir(parents=True, exist_ok=True)
    options = run_options(arguments, start=False)
    check_object(scene, options)
    for old in ("summary.json", "record.json"):
        (arguments.out / old).unlink(missing_ok=True)
    file = arguments.out / "parameters.yaml"
    bag = arguments.out / "bag"
    shutil.rmtree(bag, ignore_errors=True)
    graph = sim_graph(scene, options)
    operator = NodeProcess(
        "operator",
        (
            sys.executable,
            "-m",
            "flowbothd.operator_node",
            *("--object", arguments.object, "--seed", str(arguments.seed)),
            *("--predictor", arguments.predictor, "--out", str(arguments.out)),
            *("--timeout", str(arguments.timeout)),
        ),
        required=True,
    )
    domain = own_domain() if arguments.domain is None else arguments.domain
    nodes = graph.recorded(out=str(bag)).processes(file, required=graph.nodes)
    code = run_graph([*nodes, operator], node_environment(domain))
    complete(bag)
    summary = arguments.out / "summary.json"
    if code in (0, 1) and summary.exists():
        # Only now: drawing would take the processor away from nodes that work in real time.
        record = load_record(arguments.out)
        if record.states:
            write_report(record, scene, arguments.out)
        _save_view(bag, arguments.out / "view.rrd")
    if code == 0:
        sys.stdout.write(f"\nopened; see {arguments.out / 'report.html'}\n")
    elif code == 1 and summary.exists():
        sys.stdout.write(f"\nnot opened; see {summary}\n")
    return code


def _save_view(bag: Path, path: Path) -> None:
    """Write the run for Rerun, where that is installed."""
    try:
        save_bag(Bag(bag), path)
    except FlowBotError as error:
        sys.stdout.write(f"no {path.name}: {error}\n")
