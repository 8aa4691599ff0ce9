"""`flowbothd bench record`: does the recorder keep up, and what does it cost?"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil
from rclpy.serialization import deserialize_message

from flowbothd_common.environment import node_environment, own_domain
from flowbothd_common.parameter_files import write_parameters
from flowbothd_evaluation.record_files import write_json
from flowbothd_rosbag.metadata import BagError, read_metadata
from flowbothd_rosbag.reader import Bag
from flowbothd_rosbag.types_ros import message_class

_SETTLE = 2.0
"""Seconds without growth after which everything has been written."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd bench record`."""
    parser.add_argument(
        "--seconds",
        type=float,
        default=60.0,
        help="of depth images at 30 Hz and joint states at 100 Hz (default: %(default)s)",
    )
    parser.add_argument(
        "--cloud-seconds",
        type=float,
        default=10.0,
        help="of full clouds at 30 Hz beside these (default: %(default)s)",
    )
    parser.add_argument(
        "--keep", type=Path, default=None, metavar="DIR", help="keep the recordings here"
    )
    parser.add_argument("--json", type=Path, default=None, help="write the figures here")


def run(arguments: argparse.Namespace) -> int:
    """Measure both loads; 0 if nothing was lost."""
    results = {}
    with tempfile.TemporaryDirectory(prefix="flowbothd-bench-") as temporary:
        root = arguments.keep or Path(temporary)
        for name, seconds, clouds in (
            ("depth", arguments.seconds, False),
            ("clouds", arguments.cloud_seconds, True),
        ):
            if seconds > 0:
                results[name] = measure(root / name, seconds, clouds=clouds)
                sys.stdout.write(_text(name, results[name]) + "\n")
                sys.stdout.flush()
    if arguments.json is not None:
        write_json(arguments.json, results)
    return 0 if not any(r["lost"] for r in results.values()) else 1


def measure(bag: Path, seconds: float, *, clouds: bool) -> dict[str, Any]:
    """Record a source for a while.

    Args:
        bag: New folder.
        seconds: How long.
        clouds: Whether full clouds come too.

    Returns:
        Figures by name: published, recorded and lost messages by topic, CPU share of recorder
        (1.0 = one core), bytes of messages and of the file.

    Raises:
        BagError: recorder or source did not do their part.
    """
    environment = node_environment(own_domain())
    parameters = bag.parent / f"{bag.name}.yaml"
    parameters.parent.mkdir(parents=True, exist_ok=True)
    profile = "all" if clouds else "light"
    write_parameters(parameters, {"recorder_node": {"out": str(bag), "profile": profile}})
    module = (sys.executable, "-m", "flowbothd_rosbag.recorder_node")
    recorder = subprocess.Popen(
        [*module, "--ros-args", "--params-file", str(parameters)],
        env=environment,
        stderr=subprocess.DEVNULL,
    )
    try:
        started = psutil.Process(recorder.pid)
        _wait_for(bag, recorder)
        before = started.cpu_times()
        load = psutil.cpu_times_percent(interval=None)
        published = _publish(seconds, clouds=clouds, environment=environment)
        used = started.cpu_times()
        load = psutil.cpu_times_percent(interval=None)
        _wait_until_written(bag)
    finally:
        recorder.send_signal(signal.SIGINT)
        recorder.wait(timeout=60)
    share = (used.user + used.system - before.user - before.system) / published["seconds"]
    return {
        "seconds": published["seconds"],
        "cores": os.cpu_count(),
        "machine_busy": round(1 - load.idle / 100, 2),
        "cpu_share": round(share, 3),
        **_check(bag, published["published"]),
    }


def _wait_for(bag: Path, recorder: subprocess.Popen[bytes], timeout: float = 60.0) -> None:
    """Wait for the recorder's folder: what it takes to start does not count."""
    end = time.monotonic() + timeout
    while not bag.is_dir():
        if time.monotonic() > end or recorder.poll() is not None:
            raise BagError("the recorder does not start", got=f"exit status {recorder.poll()}")
        time.sleep(0.05)


def _publish(seconds: float, *, clouds: bool, environment: dict[str, str]) -> dict[str, Any]:
    command = [sys.executable, "-m", "flowbothd_evaluation.benchmarks.source_node"]
    command += ["--seconds", str(seconds), *(["--clouds"] if clouds else [])]
    done = subprocess.run(
        command,
        env=environment,
        capture_output=True,
        text=True,
        timeout=3 * seconds + 120,
        check=False,
    )
    if done.returncode:
        raise BagError("the source of messages failed", got=done.stderr.strip()[-500:])
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def _wait_until_written(bag: Path, timeout: float = 60.0) -> None:
    end, last, since = time.monotonic() + timeout, -1, time.monotonic()
    while time.monotonic() < end:
        count = sum(read_metadata(bag).counts.get(t, 0) for t in ("/joint_states", "/points2"))
        if count != last:
            last, since = count, time.monotonic()
        elif time.monotonic() - since > _SETTLE:
            return
        time.sleep(0.2)


def _check(bag: Path, published: dict[str, int]) -> dict[str, Any]:
    """Look for the number of every message."""
    recording = Bag(bag)
    numbers: dict[str, list[int]] = {topic: [] for topic in published}
    size = 0
    for message in recording.messages(published):
        kind = message_class(recording.topics[message.topic].type)
        header = deserialize_message(message.data, kind).header
        numbers[message.topic].append(header.stamp.sec)
        size += len(message.data)
    lost = {
        topic: sorted(set(range(count)) - set(numbers[topic])) for topic, count in published.items()
    }
    return {
        "published": published,
        "recorded": {topic: len(found) for topic, found in numbers.items()},
        "in_order": all(found == sorted(found) for found in numbers.values()),
        "lost": {topic: missing for topic, missing in lost.items() if missing},
        "message_bytes": size,
        "file_bytes": sum(file.stat().st_size for file in bag.glob("*.mcap")),
        "problems": recording.problems,
    }


def _text(name: str, r: dict[str, Any]) -> str:
    counts = ", ".join(
        f"{topic} {r['recorded'][topic]}/{count}" for topic, count in r["published"].items()
    )
    return (
        f"{name}: {counts} in {r['seconds']:.1f} s; recorder {100 * r['cpu_share']:.0f} % of a "
        f"core ({r['cores']} cores, {100 * r['machine_busy']:.0f} % busy); "
        f"{r['message_bytes'] / 1e6:.0f} MB of messages in {r['file_bytes'] / 1e6:.0f} MB"
        + (f"; LOST {r['lost']}" if r["lost"] else "; nothing lost")
    )
