"""`flowbothd record`: everything that happens in a graph, into a rosbag2 folder."""

from __future__ import annotations

import argparse
import datetime
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from flowbothd_bringup.node_graph import NodeGraph
from flowbothd_bringup.processes import run_graph
from flowbothd_common.environment import node_environment
from flowbothd_rosbag.mcap_repair import is_complete
from flowbothd_rosbag.recorder_params import PROFILES
from flowbothd_rosbag.writer import recover


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd record`."""
    parser.add_argument(
        "--out", type=Path, default=None, help="new folder (default: bags/DATE_TIME)"
    )
    parser.add_argument(
        "--profile",
        choices=PROFILES,
        default="light",
        help="light: depth images, joint states, results, events, all that a replay needs; "
        "all: camera clouds and colour too; debug: debug topics too (default: %(default)s)",
    )
    parser.add_argument(
        "--exclude", default="", metavar="REGEX", help="leave out topics that match"
    )
    parser.add_argument(
        "--domain",
        type=int,
        default=int(os.environ.get("ROS_DOMAIN_ID", "0")),
        help="ROS domain of the graph (default: ROS_DOMAIN_ID, here %(default)s)",
    )
    parser.add_argument(
        "--recover",
        type=Path,
        default=None,
        metavar="BAG",
        help="record nothing; complete a recording whose recorder was killed",
    )


def complete(folder: Path) -> None:
    """Complete the recording in a folder if its recorder could not; nothing if there is none."""
    for file in folder.glob("*.mcap"):
        if not is_complete(file):
            count = recover(folder)
            sys.stdout.write(f"{folder} was not closed: completed with {count} messages\n")


def run(arguments: argparse.Namespace) -> int:
    """Record until Ctrl-C; 0 unless the recorder failed."""
    if arguments.recover is not None:
        count = recover(arguments.recover)
        sys.stdout.write(f"{arguments.recover}: {count} messages\n")
        return 0
    now = datetime.datetime.now().astimezone()
    out: Path = arguments.out or Path("bags") / f"{now:%Y-%m-%d_%H-%M-%S}"
    values: dict[str, Any] = {"out": str(out), "profile": arguments.profile}
    if arguments.exclude:
        values["exclude"] = arguments.exclude
    environment = node_environment(arguments.domain)
    with tempfile.TemporaryDirectory(prefix="flowbothd-") as folder:
        file = Path(folder) / "recorder.yaml"
        graph = NodeGraph({}, {}).recorded(**values)
        code = run_graph(graph.processes(file), environment)
    complete(out)
    # Being interrupted is how this command ends.
    return 0 if code == 130 else code
