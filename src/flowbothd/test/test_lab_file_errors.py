"""Errors in a lab's file are reported in one line, before any node starts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from flowbothd.cli import main

DRY = "{ros__parameters: {safety: {dry_run: true}}}"


@pytest.fixture
def lab(tmp_path: Path) -> Any:
    """Writes lab.yaml, an entry a line; gives its path."""

    def write(*entries: str) -> Path:
        file = tmp_path / "lab.yaml"
        file.write_text("\n".join(entries) + "\n")
        return file

    return write


@pytest.mark.parametrize(
    "command",
    [
        ["up", "robot", "--backend", "mock"],
        pytest.param(["doctor"], marks=pytest.mark.ros),
    ],
)
def test_the_commands_say_it_in_one_line_and_start_nothing(lab: Any, capsys: Any, command: Any):
    file = lab(f"moton_node: {DRY}")
    assert main([*command, "--params", str(file)]) == 2
    error = capsys.readouterr().err
    assert "lab.yaml: the parameters of moton_node reach no node" in error
    assert "/motion_node" in error and "write /**/motion_node" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("node", "values", "said"),
    [
        # `nan > limit` is false: a NaN limit never stops anything.
        ("motion_node", "{safety: {force_limit: .nan}}", "safety.force_limit is not finite"),
        ("perception_node", "{camera.position: [0.1, .inf, 0.2]}", "camera.position is not finite"),
        ("motion_node", "{safety: {force_limit: '30'}}", "wrong type; got '30'; allowed: double"),
        ("arm_node", "{panda: {force_limit: 0.5}}", "out of range; got 0.5; allowed: 1 <= x"),
        ("motion_node", "{safety: {dryrun: true}}", "no parameter safety.dryrun; allowed: safety"),
        ("motion_node", "{safety: {workspace_min: [0.0, 0.0]}}", "wrong length; got 2; allowed: 3"),
    ],
)
def test_a_value_that_is_not_allowed_is_refused_before_anything_starts(
    lab: Any, capsys: Any, node: str, values: str, said: str
):
    """One node ended with the reason, six went on, and the arm stood without its planner."""
    file = lab(f"{node}: {{ros__parameters: {values}}}")
    assert main(["up", "robot", "--backend", "mock", "--params", str(file)]) == 2
    error = capsys.readouterr().err
    assert said in error and "lab.yaml" in error and node in error
