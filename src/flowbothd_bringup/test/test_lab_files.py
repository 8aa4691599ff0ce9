"""A lab's parameter files apply wherever the graph lives, or are an error at start."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from flowbothd_bringup.lab_files import lab_parameters
from flowbothd_bringup.node_graph import config_file
from flowbothd_bringup.robot_graph import RobotOptions, given_parameters
from flowbothd_common.errors import ParameterError
from flowbothd_common.parameter_files import (
    full_name,
    reaches,
    read_entries,
    read_parameters,
    write_parameters,
)

NODES = ("arm_node", "motion_node", "perception_node")
DRY = "{ros__parameters: {safety: {dry_run: true}}}"


@pytest.fixture
def lab(tmp_path: Path) -> Any:
    """Writes lab.yaml, an entry a line; gives its path."""

    def write(*entries: str) -> Path:
        file = tmp_path / "lab.yaml"
        file.write_text("\n".join(entries) + "\n")
        return file

    return write


@pytest.mark.parametrize("namespace", ["", "/left"])
@pytest.mark.parametrize("name", ["motion_node", "/**/motion_node", "**/motion_node", "/**"])
def test_dry_run_holds_in_the_root_and_under_a_namespace(lab: Any, name: str, namespace: str):
    """The incident: a lab's `motion_node:` was dropped under /left, and the arm moved."""
    given = lab_parameters(lab(f'"{name}": {DRY}'), ("motion_node",), namespace=namespace)
    assert given["motion_node"] == {"safety.dry_run": True}


@pytest.mark.parametrize("namespace", ["", "/left"])
def test_what_is_written_for_the_nodes_reaches_them_there(lab, tmp_path: Path, namespace: str):
    given = lab_parameters(lab(f"motion_node: {DRY}"), NODES, namespace=namespace)
    file = tmp_path / "parameters.yaml"
    write_parameters(file, given)
    (entry,) = read_entries(file)
    assert reaches(entry, full_name("motion_node", namespace))
    assert read_parameters(file) == given


def test_a_full_name_applies_to_that_node_only(lab: Any):
    file = lab(f"/left/motion_node: {DRY}", "/right/motion_node: {ros__parameters: {seed: 1}}")
    assert lab_parameters(file, NODES, namespace="left")["motion_node"] == {"safety.dry_run": True}
    assert lab_parameters(file, NODES, namespace="right")["motion_node"] == {"seed": 1}
    with pytest.raises(ParameterError, match=r"/left/motion_node, /right/motion_node reach no"):
        lab_parameters(file, NODES)


def test_the_last_entry_that_reaches_a_node_wins_as_in_ros(lab: Any):
    file = lab(
        "/**: {ros__parameters: {use_sim_time: true}}",
        "motion_node: {ros__parameters: {seed: 2}}",
        "/left/motion_node: {ros__parameters: {seed: 3}}",
    )
    ros = {"use_sim_time": True}
    assert lab_parameters(file, NODES)["motion_node"] == ros | {"seed": 2}
    assert lab_parameters(file, NODES, namespace="left")["motion_node"] == ros | {"seed": 3}
    assert lab_parameters(file, NODES)["arm_node"] == ros


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ([f"moton_node: {DRY}"], r"moton_node reach no node.*write /\*\*/motion_node"),
        ([f"motion: {DRY}"], r"motion reach no node.*write /\*\*/motion_node"),
        ([f"moton_node: {DRY}", "arm_node: {ros__parameters: {}}"], "of moton_node reach no node"),
        ([f"/left/motion_node: {DRY}"], "/left/motion_node reach no node; allowed: /arm_node"),
        # Its camera may be meant for another graph, its dry run is not.
        (
            [f"/left/motion_node: {DRY}", "perception_node: {ros__parameters: {}}"],
            "of /left/motion_node reach no node",
        ),
        (["bridge_node: {ros__parameters: {seed: 1}}"], "of bridge_node reach no node"),
        ([""], "no node at all reach no node"),
        (
            [f"motion_node: {DRY}", "/**/motion_node: {ros__parameters: {seed: 1}}"],
            "two entries for motion_node",
        ),
    ],
)
def test_an_entry_that_reaches_no_node_is_an_error(lab: Any, entries: list[str], said: str):
    """The incident: a misspelt node left the arm with the default limits, without a word."""
    with pytest.raises(ParameterError, match=said) as caught:
        lab_parameters(lab(*entries), NODES, ("bridge_node",))
    assert str(caught.value).startswith("lab.yaml")


def test_one_file_may_serve_several_graphs(lab: Any):
    file = lab("bridge_node: {ros__parameters: {seed: 1}}", f"motion_node: {DRY}")
    assert set(lab_parameters(file, NODES, ("bridge_node",))) == {"motion_node", "bridge_node"}


def test_whole_numbers_are_written_as_the_doubles_that_ros_wants(lab: Any, tmp_path: Path):
    """`force_limit: 30` ended motion_node: ROS takes an integer for no double."""
    file = lab("motion_node: {ros__parameters: {safety: {force_limit: 30}, seed: 30}}")
    values = lab_parameters(file, NODES)["motion_node"]
    assert type(values["safety.force_limit"]) is float
    assert type(values["seed"]) is int


def test_the_parameters_of_every_node_are_known():
    from flowbothd_bringup import robot_graph, sim_graph
    from flowbothd_bringup.lab_values import PARAMETERS
    from flowbothd_bringup.node_graph import RECORDER
    from flowbothd_bringup.replay_graph import PLAYER

    assert set(PARAMETERS) == {
        *sim_graph.sim_nodes("model"),
        *sim_graph.sim_nodes("oracle"),
        *robot_graph.NODES,
        RECORDER,
        PLAYER,
    }


def test_every_file_that_is_shipped_applies_under_a_namespace():
    import flowbothd_perception
    from franka_suction_driver.simulated import SIMULATED_ARM

    cameras = Path(flowbothd_perception.__file__).parent / "config"
    folders = (config_file("robot.yaml").parent, cameras, SIMULATED_ARM.parent)
    found = {}
    for folder in folders:
        for file in folder.rglob("*.yaml"):
            if "ros__parameters" in file.read_text():
                found[file.name] = list(yaml.safe_load(file.read_text()))
    shipped = {"sim.yaml", "robot.yaml", "fr3.yaml", "azure_kinect.yaml", SIMULATED_ARM.name}
    assert shipped <= set(found)
    for file, entries in found.items():
        assert all(reaches(e, full_name(e.split("/")[-1], "left")) for e in entries), file


def test_a_real_graph_in_a_namespace_takes_what_is_written_for_it(lab: Any):
    file = lab(f"/left/motion_node: {DRY}", f"/right/motion_node: {DRY}")
    options = RobotOptions(backend="mock", files=(file,), namespace="/left")
    assert given_parameters(options)["motion_node"]["safety.dry_run"] is True
