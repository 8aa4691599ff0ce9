"""Recordings that lack what a command needs: answered with a message, never with a traceback."""

from __future__ import annotations

import sys

import pytest

pytest.importorskip("mcap", reason="mcap is not installed")

from flowbothd_rosbag.metadata import Topic
from flowbothd_rosbag.writer import BagWriter


def text(words: str) -> bytes:
    """CDR of a std_msgs/String."""
    data = words.encode() + b"\0"
    return b"\x00\x01\x00\x00" + len(data).to_bytes(4, "little") + data


def chatter(folder, names=("/chatter",), kind="std_msgs/msg/String", count=3, attach=()):
    """A recording of the same words on some topics."""
    writer = BagWriter(folder, chunk_size=4000)
    for name in names:
        writer.add_topic(Topic(name, kind))
        for i in range(count):
            writer.write(name, i + 1, text(f"{i} " + "x" * 100))
    for name, content in attach:
        writer.attach(name, "application/yaml", content)
    writer.close()
    return folder


OURS = ("/policy/decisions", "/policy/events", "/object_cloud", "/flow/prediction", "/joint_states")
COMMANDS = (
    ("replay", "--recompute", "policy"),
    ("replay", "--recompute", "perception,inference,policy"),
    ("report", "--no-animation"),
    ("view", "--save", "view.rrd"),
)
CASES = {
    "empty": lambda p: chatter(p, names=()),
    "somebody else's": chatter,
    "our names, other types": lambda p: chatter(p, names=OURS),
    "our names, unknown types": lambda p: chatter(p, names=OURS, kind="nobody_msgs/msg/Unknown"),
    "our types, other bytes": lambda p: chatter(
        p, names=("/policy/decisions",), kind="flowbothd_interfaces/msg/PolicyDecision"
    ),
    "damaged parameters": lambda p: chatter(p, attach=[("parameters.yaml", b"\xff: [")]),
    "other parameters": lambda p: chatter(p, attach=[("parameters.yaml", b"[1, 2]")]),
    "odd parameters": lambda p: chatter(p, attach=[("parameters.yaml", b"a: 1\nb: {c: 2}\n")]),
}


@pytest.mark.ros
@pytest.mark.parametrize("command", COMMANDS, ids=lambda c: " ".join(c[:3]))
@pytest.mark.parametrize("case", CASES)
def test_every_command_says_on_one_line_what_a_recording_lacks(
    tmp_path, monkeypatch, capsys, case, command
):
    pytest.importorskip("rclpy", reason="ROS is not installed")
    if command[0] == "view":
        pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    from flowbothd.cli import main

    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    monkeypatch.chdir(tmp_path)
    folder = CASES[case](tmp_path / "bag")
    assert main([command[0], str(folder), *command[1:]]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert told and all(line.startswith("flowbothd: ") for line in told)
