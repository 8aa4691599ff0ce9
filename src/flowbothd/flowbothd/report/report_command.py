"""`flowbothd report`: a page with pictures and figures of a recording, for any browser."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flowbothd.report.report import write_report
from flowbothd_common.errors import ObjectModelError
from flowbothd_evaluation.run_record.record import RunRecord
from flowbothd_rosbag import about
from flowbothd_rosbag.lookup import add_namespace, topic_called
from flowbothd_rosbag.metadata import BagError
from flowbothd_rosbag.reader import Bag
from flowbothd_rosbag.types_ros import type_of
from sim_bridge.scenes import Scene, scene_for


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd report`."""
    parser.add_argument("bag", type=Path, help="folder of a recording, or its data file")
    parser.add_argument(
        "--out", type=Path, default=None, help="folder of the page (default: report in the bag's)"
    )
    add_namespace(parser)
    parser.add_argument("--no-animation", action="store_true", help="leave out the moving picture")


class _Ears:
    """Stands where a node would be: keeps callbacks by the ends of names and types of topics."""

    def __init__(self) -> None:
        self.callbacks: dict[tuple[str, str], Callable[[Any], None]] = {}

    def create_subscription(
        self, kind: Any, topic: str, callback: Callable[[Any], None], profile: Any
    ) -> str:
        """Remember who wants a topic."""
        self.callbacks[topic, type_of(kind)] = callback
        return topic


def record_of(bag: Bag) -> RunRecord:
    """The run that a recording holds.

    Raises:
        BagError: it holds no decisions.
    """
    from flowbothd.replay.story import decoded, predictor_name
    from flowbothd.report.collector import Collector
    from flowbothd_rosbag.attached import stored_parameters
    from franka_suction_driver.arm.params import ARM_JOINTS

    parameters = stored_parameters(bag)
    bridge = parameters.get("bridge_node", {})
    record = RunRecord(
        object=str(bridge.get("object", "a real object")),
        mode="",
        seed=int(parameters.get("policy_node", {}).get("seed", 0)),
        predictor=predictor_name(parameters),
    )
    ears = _Ears()
    collector = Collector(ears, record, ARM_JOINTS)
    names = {topic_called(bag, *which): take for which, take in ears.callbacks.items()}
    present = {name: take for name, take in names.items() if name is not None}
    times = []
    for message in bag.messages(present):
        present[message.topic](decoded(bag, message))
        times.append(message.time)
    record.mode = collector.mode
    record.wall_s = (times[-1] - times[0]) * 1e-9 if times else 0.0
    if not record.decisions:
        raise BagError(
            f"{bag.path} holds no policy/decisions", hint="a report tells of the policy's decisions"
        )
    return record


def scene_of(bag: Bag, record: RunRecord) -> Scene | None:
    """The scene that was simulated; None for a real one, or where its object is not here."""
    if not record.states or about.PARAMETERS not in bag.attachments():
        return None
    try:
        return scene_for(record.object)
    except ObjectModelError:
        return None


def run(arguments: argparse.Namespace) -> int:
    """Write the page."""
    bag = Bag(arguments.bag, arguments.namespace)
    folder = arguments.out or (
        bag.path / "report" if bag.path.is_dir() else bag.path.with_suffix(".report")
    )
    record = record_of(bag)
    for problem in bag.problems:
        sys.stderr.write(f"flowbothd: {problem}\n")
    write_report(record, scene_of(bag, record), folder, animation=not arguments.no_animation)
    sys.stdout.write(f"{folder / 'report.html'}\n")
    return 0
