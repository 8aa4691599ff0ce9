"""`flowbothd up sim`: all nodes against the simulation, until Ctrl-C."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from flowbothd_bringup.processes import run_graph
from flowbothd_bringup.sim_graph import MODEL, PREDICTORS, RunOptions, check_object, sim_graph
from flowbothd_common.environment import node_environment, own_domain
from sim_bridge.scenes import scene_for


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that every command shares which starts the graph."""
    parser.add_argument(
        "--object",
        default="custom_door",
        help="scene, PartNet-Mobility folder or .urdf file (default: %(default)s)",
    )
    parser.add_argument(
        "--mode", default="", help="how an ambiguous object opens (default: drawn from the seed)"
    )
    parser.add_argument("--seed", type=int, default=0, help="run seed (default: %(default)s)")
    parser.add_argument(
        "--predictor",
        choices=PREDICTORS,
        default=MODEL,
        help="who predicts the flow (default: %(default)s)",
    )
    parser.add_argument(
        "--model",
        default="",
        help="weights of the predictor 'model': name, folder or file (default: those of sim.yaml)",
    )
    parser.add_argument(
        "--domain", type=int, default=None, help="ROS domain, 0..101 (default: one of its own)"
    )


def run_options(arguments: argparse.Namespace, *, start: bool) -> RunOptions:
    """Options of the run that the shared arguments ask for."""
    return RunOptions(
        seed=arguments.seed,
        mode=arguments.mode,
        predictor=arguments.predictor,
        model=arguments.model,
        start=start,
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd up sim`."""
    add_run_arguments(parser)
    parser.add_argument("--start", action="store_true", help="let the policy begin by itself")


def run(arguments: argparse.Namespace) -> int:
    """Run the graph until Ctrl-C."""
    scene = scene_for(arguments.object)
    options = run_options(arguments, start=arguments.start)
    check_object(scene, options)
    domain = own_domain() if arguments.domain is None else arguments.domain
    environment = node_environment(domain)
    graph = sim_graph(scene, options)
    with tempfile.TemporaryDirectory(prefix="flowbothd-") as folder:
        file = Path(folder) / "parameters.yaml"
        sys.stdout.write(
            f"ROS_DOMAIN_ID={domain} ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST reaches this graph; "
            "Ctrl-C ends it.\n"
        )
        sys.stdout.flush()
        code = run_graph(graph.processes(file), environment)
    # Being interrupted is how this command ends.
    return 0 if code == 130 else code
