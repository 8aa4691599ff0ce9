"""Parameter files: their entries, the nodes they reach, and what is said of the others."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import pytest

from flowbothd_common.errors import ParameterError
from flowbothd_common.parameter_files import (
    astray,
    full_name,
    missing_entry,
    reaches,
    read_entries,
    unreached,
)

NODES = ("/motion_node", "/left/motion_node", "/left/arm/motion_node", "/left/arm_node")
ENTRIES = (
    "/**/motion_node",
    "**/motion_node",
    "/**",
    "motion_node",
    "/motion_node",
    "/left/motion_node",
    "left/motion_node",
    "/*/motion_node",
    "/*/*/motion_node",
    "/left/**",
    "/left/*",
    "/left/**/motion_node",
    "*",
    "/arm_node",
)


def write(folder: Path, text: str) -> Path:
    file = folder / "lab.yaml"
    file.write_text(text)
    return file


def test_groups_and_namespaces_are_joined_in_order(tmp_path):
    file = write(
        tmp_path,
        "/**: {ros__parameters: {use_sim_time: true}}\n"
        "left:\n  motion_node:\n    ros__parameters: {safety: {dry_run: true, force_limit: 30.0}}\n"
        "  ros__parameters: {seed: 1}\n"
        "/right/arm_node: {ros__parameters: {}}\n",
    )
    assert list(read_entries(file).items()) == [
        ("/**", {"use_sim_time": True}),
        ("left", {"seed": 1}),
        ("left/motion_node", {"safety.dry_run": True, "safety.force_limit": 30.0}),
        ("/right/arm_node", {}),
    ]
    assert read_entries(write(tmp_path, "# nothing yet\n")) == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("motion_node: {safety: 1}", "ros__parameters"),
        ("motion_node: {ros__parameters: }", "ros__parameters of motion_node"),
        ("motion_node:", "got motion_node: None"),
        ("- motion_node", "at the top"),
        ("motion_node: [", "is not a parameter file"),
    ],
)
def test_what_is_no_parameter_file_is_refused_by_name(tmp_path, text, said):
    with pytest.raises(ParameterError, match=said) as caught:
        read_entries(write(tmp_path, text))
    assert "lab.yaml" in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_file_is_an_error_of_ours(tmp_path):
    with pytest.raises(ParameterError, match=r"none\.yaml cannot be read"):
        read_entries(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    "text",
    [
        "a: {ros__parameters: {b: 1}}\na: {ros__parameters: {c: 1}}\n",
        "a: {ros__parameters: {safety: {force_limit: 30.0, force_limit: 40.0}}}\n",
    ],
)
def test_a_key_that_is_written_twice_is_refused(tmp_path, text):
    """A second block of motion_node replaced the first without a word, and with it dry_run."""
    with pytest.raises(ParameterError, match="is written twice"):
        read_entries(write(tmp_path, text))


def test_full_names():
    assert full_name("motion_node") == "/motion_node"
    assert full_name("motion_node", "/") == "/motion_node"
    assert full_name("motion_node", "left/") == "/left/motion_node"
    assert full_name("motion_node", "/left/arm") == "/left/arm/motion_node"


@pytest.mark.ros
def test_an_entry_reaches_a_node_exactly_where_ros_says_so(tmp_path):
    """Guessed semantics would call a file good that ROS drops."""
    rclpy = pytest.importorskip("rclpy", reason="ROS is not installed")
    from rclpy.context import Context
    from rclpy.node import Node

    context = Context()
    rclpy.init(context=context, args=[])
    try:
        for name, entry in itertools.product(NODES, ENTRIES):
            file = write(tmp_path, f'"{entry}": {{ros__parameters: {{dry_run: true}}}}\n')
            namespace, _, base = name.rpartition("/")
            arguments = ["--ros-args", "--params-file", str(file)]
            if namespace:
                arguments += ["-r", f"__ns:={namespace}"]
            node = Node(base, context=context, cli_args=arguments, enable_rosout=False)
            assert node.get_fully_qualified_name() == name
            given = "dry_run" in node._parameter_overrides
            node.destroy_node()
            assert reaches(entry, name) == given, f"{entry} and {name}"
    finally:
        rclpy.try_shutdown(context=context)


@pytest.mark.parametrize(
    ("written", "stray"),
    [
        (["/**/motion_node", "/left/motion_node"], []),
        (["/left/motion_node", "/right/motion_node"], ["/left/motion_node", "/right/motion_node"]),
        (["/motion_node", "/left/motion_node"], []),
        (["/**", "/left/motion_node"], ["/left/motion_node"]),
        (["/left/bridge_node", "moton_node"], []),
        (["/left/**"], ["/left/**"]),
        (["/**", "/left/**"], []),
    ],
)
def test_an_entry_is_astray_if_its_node_is_here_and_none_of_its_name_reaches_it(written, stray):
    assert astray(written, ["/motion_node", "/arm_node"]) == stray


def test_the_errors_name_the_entries_the_nodes_and_what_to_write():
    nodes = [full_name(n, "left") for n in ("motion_node", "arm_node")]
    text = str(unreached("lab.yaml", ["moton_node"], nodes))
    assert "the parameters of moton_node reach no node" in text
    assert "/left/arm_node, /left/motion_node" in text
    assert "write /**/motion_node:" in text
    assert "write /**/NODE" in str(unreached("lab.yaml", ["camera"], nodes))
    assert "no node at all" in str(unreached("lab.yaml", [], nodes))
    text = str(missing_entry("lab.yaml", ["motion_node"], "/left/motion_node"))
    assert "no parameters for /left/motion_node" in text and "write /**/motion_node" in text


NODE = """
import os, sys
import rclpy
from rclpy.node import Node
from flowbothd_common.ros.node_main import run_node


class Motion(Node):
    def __init__(self):
        super().__init__("motion_node", automatically_declare_parameters_from_overrides=True)
        self.create_timer(0.01, self.on_timer)

    def on_timer(self):
        os.write(1, f"runs as {self.get_fully_qualified_name()}".encode())
        rclpy.shutdown()


raise SystemExit(run_node(Motion, strict_files=sys.argv[1] == "strict"))
"""


def run(strict: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", NODE, strict, *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.ros
def test_a_node_that_moves_an_arm_refuses_a_file_that_says_nothing_to_it(tmp_path):
    """The incident: `motion_node:` under a namespace; no dry run, and 40 N instead of 30."""
    pytest.importorskip("rclpy", reason="ROS is not installed")
    file = write(tmp_path, "motion_node: {ros__parameters: {dry_run: true}}\n")
    given = ["--ros-args", "--params-file", str(file)]
    below = [*given, "-r", "__ns:=/left"]
    assert run("strict", *given).stdout == "runs as /motion_node"
    refused = run("strict", *below)
    assert refused.returncode == 2 and not refused.stdout
    assert "lab.yaml has no parameters for /left/motion_node" in refused.stderr
    assert "Traceback" not in refused.stderr
    warned = run("lenient", *below)
    assert warned.returncode == 0 and warned.stdout == "runs as /left/motion_node"
    assert "lab.yaml has no parameters for /left/motion_node" in warned.stderr
    write(tmp_path, "/**/motion_node: {ros__parameters: {dry_run: true}}\n")
    assert run("strict", *below).stdout == "runs as /left/motion_node"


@pytest.mark.ros
def test_only_files_among_the_ros_arguments_count():
    pytest.importorskip("rclpy", reason="ROS is not installed")
    from flowbothd_common.ros.parameters import given_files

    words = "--params-file a --ros-args -r x:=y --params-file b -- --params-file c --ros-args"
    assert given_files([*words.split(), "--params-file", "d"]) == [Path("b"), Path("d")]
    assert given_files([]) == []
