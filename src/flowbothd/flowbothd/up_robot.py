"""`flowbothd up robot`: all nodes on a robot, until Ctrl-C."""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from flowbothd_bringup.processes import run_graph
from flowbothd_bringup.robot_graph import RobotOptions, robot_graph
from flowbothd_common.environment import node_environment
from franka_suction_driver.backend_params import BACKENDS


def add_robot_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that `up robot` and `doctor` share."""
    parser.add_argument("--robot", default="", metavar="IP", help="address of the control unit")
    parser.add_argument(
        "--params",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="parameters of the lab: calibration, limits; may be given more than once",
    )
    parser.add_argument(
        "--backend",
        choices=BACKENDS,
        default="panda",
        help="mock: everything runs, no hardware is touched (default: %(default)s)",
    )
    parser.add_argument("--domain", type=int, default=0, help="ROS domain (default: %(default)s)")


def robot_options(arguments: argparse.Namespace) -> RobotOptions:
    """Options that the shared arguments ask for."""
    return RobotOptions(arguments.robot, arguments.backend, tuple(arguments.params))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd up robot`."""
    add_robot_arguments(parser)
    parser.add_argument(
        "--model",
        default="",
        help="weights: name, folder or file (default: those of config/robot.yaml)",
    )
    parser.add_argument("--speed", type=float, default=None, help="part of all speeds, 0.01..1")
    parser.add_argument("--dry-run", action="store_true", help="plan and show, but never move")
    parser.add_argument("--start", action="store_true", help="let the policy begin by itself")
    parser.add_argument(
        "--network",
        action="store_true",
        help="let other computers take part; otherwise only this one is in the graph",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the graph until Ctrl-C."""
    options = replace(
        robot_options(arguments),
        model=arguments.model,
        speed=arguments.speed,
        dry_run=arguments.dry_run,
        start=arguments.start,
    )
    graph = robot_graph(options)
    environment = node_environment(arguments.domain)
    if arguments.network:
        environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    motion = graph.parameters["motion_node"]
    with tempfile.TemporaryDirectory(prefix="flowbothd-") as folder:
        file = Path(folder) / "parameters.yaml"
        sys.stdout.write(
            f"backend {options.backend}, speed {100 * float(motion['safety.speed_scale']):.0f} %"
            f"{', DRY RUN' if motion.get('safety.dry_run') else ''}; "
            "stop with motion/halt or the user stop; "
            f"`flowbothd doctor --domain {arguments.domain}` lists what is missing; Ctrl-C ends.\n"
        )
        sys.stdout.flush()
        code = run_graph(graph.processes(file), environment)
    return 0 if code == 130 else code
