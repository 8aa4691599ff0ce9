"""The graph on a robot: its parameters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flowbothd_bringup.node_graph import config_file
from flowbothd_bringup.robot_graph import (
    NODES,
    RobotOptions,
    given_parameters,
    missing_parameters,
    robot_graph,
    robot_parameters,
)
from flowbothd_common.errors import ParameterError
from flowbothd_common.parameter_files import write_parameters
from flowbothd_common.parameters import build, specifications
from franka_suction_driver.arm.kinematics import make_kinematics
from franka_suction_driver.arm.limits import robot_limits
from franka_suction_driver.params import MotionParams

CAMERA = {"camera.position": [0.6, -1.0, 0.6], "camera.quaternion": [0.0, 0.0, 0.0, 1.0]}


@pytest.fixture
def lab(tmp_path: Path) -> RobotOptions:
    file = tmp_path / "lab.yaml"
    write_parameters(file, {"perception_node": CAMERA})
    return RobotOptions("172.16.0.2", "panda", (file,))


def test_a_missing_calibration_or_address_is_an_error_that_names_them(lab: RobotOptions) -> None:
    with pytest.raises(ParameterError, match=r"camera\.position.*robot_ip"):
        robot_parameters(RobotOptions())
    with pytest.raises(ParameterError, match=r"arm_node panda\.robot_ip"):
        robot_parameters(replace(lab, robot_ip=""))
    assert missing_parameters(given_parameters(lab)) == []


def test_the_defaults_of_a_robot_are_slow_and_watched(lab: RobotOptions) -> None:
    parameters = robot_parameters(lab)
    motion = parameters["motion_node"]
    assert motion["safety.speed_scale"] == 0.1
    assert motion["input_timeout"] == 0.1
    assert set(motion["watch_nodes"]) == set(NODES) - {"motion_node"}
    assert "arm_node" in motion["ready_nodes"]
    assert parameters["arm_node"]["panda.robot_ip"] == parameters["pump_node"]["robot_ip"]
    assert parameters["policy_node"]["autostart"] is False
    assert motion["camera_position"] == CAMERA["camera.position"]


def test_the_command_line_wins_over_the_files(lab: RobotOptions) -> None:
    options = replace(lab, backend="mock", speed=0.3, dry_run=True, start=True)
    parameters = robot_parameters(options)
    assert parameters["motion_node"]["safety.speed_scale"] == 0.3
    assert parameters["motion_node"]["safety.dry_run"] is True
    assert parameters["pump_node"]["backend"] == "mock"
    assert parameters["policy_node"]["autostart"] is True


def test_force_limits_in_the_wrong_order_are_refused(lab: RobotOptions, tmp_path: Path) -> None:
    """The trap: the robot's reflex fires first, and the arm stands until somebody recovers it."""
    file = tmp_path / "more.yaml"
    write_parameters(file, {"motion_node": {"safety.force_limit": 60.0}})
    with pytest.raises(ParameterError, match=r"must trip before panda\.force_limit"):
        robot_parameters(replace(lab, files=(*lab.files, file)))


def test_unknown_nodes_and_files_are_refused(lab: RobotOptions, tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    write_parameters(file, {"bridge_node": {"seed": 1}})
    with pytest.raises(ParameterError, match=r"of bridge_node reach no node"):
        robot_parameters(replace(lab, files=(file,)))
    with pytest.raises(ParameterError, match="does not exist"):
        robot_parameters(replace(lab, files=(tmp_path / "none.yaml",)))


def test_a_robot_has_no_oracle(lab: RobotOptions, tmp_path: Path) -> None:
    """The incident: the inference node of a robot took `predictor: oracle` from a file."""
    graph = robot_graph(lab)
    assert "oracle_node" not in {*graph.nodes, *graph.parameters}
    file = tmp_path / "oracle.yaml"
    write_parameters(file, {"inference_node": {"predictor": "oracle"}})
    with pytest.raises(ParameterError, match="inference_node has no parameter predictor"):
        robot_parameters(replace(lab, files=(*lab.files, file)))
    # A file that serves the simulation too may have an entry for it; no node is started by that.
    write_parameters(file, {"oracle_node": {"noise": 0.0}, "motion_node": {"seed": 1}})
    assert "oracle_node" not in robot_graph(replace(lab, files=(*lab.files, file))).nodes


def test_every_node_has_a_process_of_its_own(lab: RobotOptions, tmp_path: Path) -> None:
    """The trap: read_once holds Python's lock; the pump must not share the arm's process."""
    processes = robot_graph(lab).processes(tmp_path / "p.yaml")
    assert [process.name for process in processes] == list(NODES)
    assert len({process.command[2] for process in processes}) == len(NODES)


def test_an_fr3_comes_by_parameter_file(lab: RobotOptions) -> None:
    """Limits of the wrong arm are rejected by the robot: they are parameters, never code."""
    assert config_file("fr3.yaml").is_file()
    parameters = robot_parameters(replace(lab, files=(Path("fr3.yaml"), *lab.files)))
    known = {spec.name for spec in specifications(MotionParams)}
    given = {n: v for n, v in parameters["motion_node"].items() if n in known}
    params = build(MotionParams, given)
    kinematics = make_kinematics(params)
    assert kinematics.joint_names[0] == "fr3_joint1"
    limits = robot_limits(kinematics, params.robot)
    assert limits.lower[5] == 0.8521
    assert limits.velocity[1] == 1.0
    start = np.array(params.robot.start_positions)
    assert limits.box(0.05).contains(start)
