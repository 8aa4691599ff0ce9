"""`flowbothd replay`: a recording played to nodes, or recomputed and compared."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

from flowbothd_bringup.processes import run_graph
from flowbothd_bringup.replay_graph import PLAYER, playing_graph
from flowbothd_common.environment import node_environment, own_domain
from flowbothd_rosbag.lookup import add_namespace
from flowbothd_rosbag.metadata import BagError
from flowbothd_rosbag.reader import Bag, Span


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd replay`."""
    parser.add_argument("bag", type=Path, help="folder of a recording, or its data file")
    parser.add_argument("--rate", type=float, default=1.0, help="speed (default: %(default)s)")
    parser.add_argument(
        "--from",
        dest="begin",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="begin this long after the first message (default: %(default)s)",
    )
    parser.add_argument(
        "--to", dest="end", type=float, default=None, metavar="SECONDS", help="end there"
    )
    parser.add_argument("--loop", action="store_true", help="start over at the end")
    parser.add_argument(
        "--exclude", default="", metavar="REGEX", help="leave out topics that match"
    )
    parser.add_argument(
        "--domain",
        type=int,
        default=None,
        help="ROS domain to play into (default: ROS_DOMAIN_ID, else one of its own)",
    )
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--open-loop",
        action="store_true",
        help="play everything as it was recorded; the default",
    )
    how.add_argument(
        "--nodes",
        default="",
        metavar="perception",
        help="start perception_node as it was configured and play all but what it puts out",
    )
    how.add_argument(
        "--recompute",
        default="",
        metavar="NODES",
        help="play nothing; run perception, inference, policy (comma-separated) again on what was "
        "recorded, as fast as they go, and compare: 0 identical, 1 different",
    )
    add_namespace(parser)
    parser.add_argument(
        "--report", type=Path, default=None, metavar="FILE", help="comparison as JSON"
    )


def run(arguments: argparse.Namespace) -> int:
    """Play or compare; 0 success, 1 different, 2 unusable."""
    if arguments.recompute:
        return _recompute(arguments)
    if arguments.nodes not in ("", "perception"):
        raise BagError(
            "nodes that can be driven by topics alone",
            got=arguments.nodes,
            allowed="perception",
            hint="inference and policy are driven by services and actions: use --recompute",
        )
    return _play(arguments)


def _recompute(arguments: argparse.Namespace) -> int:
    from flowbothd.replay.recompute import recompute

    bag = Bag(arguments.bag, arguments.namespace)
    nodes = [name.strip() for name in arguments.recompute.split(",")]
    result = recompute(bag, nodes, Span(arguments.begin, arguments.end))
    sys.stdout.write(result.text() + "\n")
    if arguments.report is not None:
        result.write(arguments.report)
    sys.stdout.write("identical\n" if result.identical else "different\n")
    return 0 if result.identical else 1


def _play(arguments: argparse.Namespace) -> int:
    if arguments.namespace is not None and not arguments.nodes:
        raise BagError(
            "--namespace chooses the graph for --nodes and --recompute",
            got=arguments.namespace,
            hint="leave the topics of another graph out with --exclude, such as '^/right/'",
        )
    graph = playing_graph(
        arguments.bag,
        rate=arguments.rate,
        begin=arguments.begin,
        end=arguments.end or 0.0,
        loop=arguments.loop,
        exclude=arguments.exclude,
        perception=bool(arguments.nodes),
        namespace=arguments.namespace,
    )
    domain = arguments.domain
    if domain is None:
        domain = int(os.environ.get("ROS_DOMAIN_ID", own_domain()))
    sys.stdout.write(f"ROS_DOMAIN_ID={domain} ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST hears it.\n")
    sys.stdout.flush()
    with tempfile.TemporaryDirectory(prefix="flowbothd-") as folder:
        file = Path(folder) / "parameters.yaml"
        code = run_graph(graph.processes(file, required=(PLAYER,)), node_environment(domain))
    return 0 if code == 130 else code
