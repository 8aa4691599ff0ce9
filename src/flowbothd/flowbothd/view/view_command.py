"""`flowbothd view`: a running graph or a recording in Rerun."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from pathlib import Path
from typing import Any

from flowbothd_common.errors import FlowBotError
from flowbothd_rosbag.lookup import add_namespace, topic_called
from flowbothd_rosbag.metadata import BagError
from flowbothd_rosbag.reader import Bag, Span

APPLICATION = "flowbothd"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd view`."""
    parser.add_argument(
        "what", nargs="?", default="live", help="a recording, or live (default: %(default)s)"
    )
    parser.add_argument(
        "--save", type=Path, default=None, metavar="FILE.rrd", help="write a file, open no window"
    )
    parser.add_argument(
        "--domain",
        type=int,
        default=int(os.environ.get("ROS_DOMAIN_ID", "0")),
        help="live: ROS domain of the graph (default: ROS_DOMAIN_ID, here %(default)s)",
    )
    add_namespace(parser)
    parser.add_argument(
        "--from", dest="begin", type=float, default=0.0, metavar="SECONDS", help="begin there"
    )
    parser.add_argument(
        "--to", dest="end", type=float, default=None, metavar="SECONDS", help="end there"
    )


def rerun() -> Any:
    """The rerun module.

    Raises:
        FlowBotError: it is not installed; the message says how to get it, and what goes without.
    """
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        raise FlowBotError(
            f"Rerun is not installed ({error})",
            hint="`pip install rerun-sdk` into this environment (450 MB, needs numpy 2); "
            "`flowbothd report BAG` writes a page with pictures without it",
        ) from error


def run(arguments: argparse.Namespace) -> int:
    """Show or save."""
    if arguments.what == "live":
        return _live(arguments)
    bag = Bag(Path(arguments.what), arguments.namespace)
    span = Span(arguments.begin, arguments.end)
    known = list(bag.problems)
    for problem in known:
        sys.stderr.write(f"flowbothd: {problem}\n")
    recording = _recording(arguments.save)
    shown = show_bag(bag, recording, span)
    recording.flush()
    for problem in bag.problems[len(known) :]:
        # Found on the way: damage shows only where it is read.
        sys.stderr.write(f"flowbothd: {problem}\n")
    if arguments.save is not None:
        size = arguments.save.stat().st_size / 1e6
        sys.stdout.write(f"{arguments.save}: {shown} messages, {size:.1f} MB\n")
    return 0


def _recording(save: Path | None) -> Any:
    from flowbothd.view.blueprint import blueprint

    recording = rerun().RecordingStream(APPLICATION)
    if save is not None:
        save.parent.mkdir(parents=True, exist_ok=True)
        recording.save(str(save), default_blueprint=blueprint())
    else:
        recording.spawn(default_blueprint=blueprint())
    return recording


def save_bag(bag: Bag, path: Path) -> int:
    """Write a recording as a Rerun file; returns how many messages are shown in it.

    Raises:
        FlowBotError: Rerun is not installed.
        BagError: the recording holds nothing that can be shown.
    """
    recording = _recording(path)
    shown = show_bag(bag, recording)
    recording.flush()
    recording.disconnect()
    return shown


def show_bag(bag: Bag, recording: Any, span: Span | None = None) -> int:
    """Show a recording's messages; returns how many.

    Raises:
        BagError: it holds nothing that can be shown.
    """
    from flowbothd.replay.story import decoded
    from flowbothd.view.camera import camera_pose
    from flowbothd.view.run_view import RunView
    from flowbothd_rosbag.attached import stored_parameters

    parameters = stored_parameters(bag).get("perception_node", {})
    view = RunView(recording, camera_pose(parameters))
    wanted = [topic_called(bag, *which) for which in view.topics]
    topics = [name for name in wanted if name is not None]
    if not topics:
        raise BagError(
            f"{bag.path} holds nothing to show", got=", ".join(bag.topics) or "no topics"
        )
    count = 0
    if span is not None and span.begin > 0:
        # What late joiners were given before: without the description there is no robot to see.
        latched = [name for name in topics if bag.topics[name].latched]
        for message in bag.messages(latched, Span(0.0, span.begin)):
            view.show(message.topic, decoded(bag, message))
    for message in bag.messages(topics, span):
        view.show(message.topic, decoded(bag, message))
        count += 1
    return count


def _live(arguments: argparse.Namespace) -> int:
    from flowbothd_common.environment import node_environment

    # The transport has to be chosen before ROS is imported.
    os.environ.update(node_environment(arguments.domain))
    from flowbothd.view import live_node

    recording = _recording(arguments.save)
    code = live_node.run(recording)
    recording.flush()
    return code
