"""The graph on a robot: its nodes, their parameters, and what must be given."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from flowbothd_bringup.lab_files import lab_parameters
from flowbothd_bringup.node_graph import DECIDING_NODES, NodeGraph, config_file
from flowbothd_common.errors import ParameterError
from flowbothd_common.parameter_files import Parameters, read_parameters
from flowbothd_common.parameters import build, specifications
from franka_suction_driver.backend_params import BACKENDS, ArmNodeParams
from franka_suction_driver.params import MotionNodeParams

NODES = {
    "arm_node": "franka_suction_driver.arm_node",
    "pump_node": "franka_suction_driver.pump_node",
    **DECIDING_NODES,
}
"""Node name -> module that runs it. What blocks Python, the pump, has a process of its own."""

_OTHERS = ("bridge_node", "oracle_node", "recorder_node", "player_node")
"""Nodes of other graphs that a lab's file may have parameters of."""

_CALIBRATION = ("camera.position", "camera.quaternion")


@dataclass(frozen=True)
class RobotOptions:
    """Options of the command line.

    Attributes:
        robot_ip: Address of the control unit.
        backend: topic, panda or mock.
        files: Parameter files of the lab; later ones win.
        model: Name, folder or file of the weights; empty = the inference node's own default.
        speed: Part of all speeds; None = the files'.
        dry_run: Plan and show, never move.
        start: Whether the policy begins by itself.
        namespace: ROS namespace of the graph, by which the files' full names are judged.
    """

    robot_ip: str = ""
    backend: str = "panda"
    files: tuple[Path, ...] = ()
    model: str = ""
    speed: float | None = None
    dry_run: bool = False
    start: bool = False
    namespace: str = ""


def robot_parameters(options: RobotOptions) -> Parameters:
    """Parameters of every node: config/robot.yaml, then the lab's files, then the command line.

    Raises:
        ParameterError: a file, the calibration or the address is missing, the force limits are in
            the wrong order, or a value is out of range.
    """
    result = given_parameters(options)
    missing = missing_parameters(result)
    if missing:
        raise ParameterError(
            "required parameters are missing",
            got=", ".join(missing),
            hint="write them into a file for --params; docs/tutorials/own_robot.md has one",
        )
    result["motion_node"].setdefault(
        "camera_position", result["perception_node"]["camera.position"]
    )
    check_force_limits(result)
    return result


def given_parameters(options: RobotOptions) -> Parameters:
    """The same, without asking for what is missing; for the doctor.

    Raises:
        ParameterError: a file is missing, or has parameters that reach no node.
    """
    if options.backend not in BACKENDS:
        raise ParameterError("unknown backend", got=options.backend, allowed=", ".join(BACKENDS))
    result = read_parameters(config_file("robot.yaml"))
    for file in options.files:
        for node, values in lab_parameters(file, NODES, _OTHERS, options.namespace).items():
            result.setdefault(node, {}).update(values)
    _apply(result, options)
    return result


def missing_parameters(parameters: Parameters) -> list[str]:
    """Required parameters that the lab has not given."""
    missing = [
        f"perception_node {name}"
        for name in _CALIBRATION
        if not parameters.get("perception_node", {}).get(name)
    ]
    arm, pump = parameters.get("arm_node", {}), parameters.get("pump_node", {})
    if arm.get("backend") == "panda" and not arm.get("panda.robot_ip"):
        missing.append("arm_node panda.robot_ip")
    if pump.get("backend") == "panda" and not pump.get("robot_ip"):
        missing.append("pump_node robot_ip")
    return missing


def check_force_limits(parameters: Parameters) -> None:
    """Our limits must trip one after the other, and all before the robot's reflex.

    Raises:
        ParameterError: they would not.
    """
    motion: Any = build(MotionNodeParams, _known(MotionNodeParams, parameters["motion_node"]))
    arm: Any = build(ArmNodeParams, _known(ArmNodeParams, parameters["arm_node"]))
    chain = (
        ("flow_step.force_limit", motion.flow_step.force_limit),
        ("safety.force_limit", motion.safety.force_limit),
        ("panda.force_limit", arm.panda.force_limit),
        ("panda.collision_force", arm.panda.collision_force),
    )
    for (low, smaller), (high, larger) in pairwise(chain):
        if smaller >= larger:
            raise ParameterError(
                f"{low} must trip before {high}",
                got=f"{smaller:g} N and {larger:g} N",
                allowed=" < ".join(name for name, _ in chain),
            )


def robot_graph(options: RobotOptions) -> NodeGraph:
    """Return the graph on a robot; the camera's driver is started by the lab.

    Raises:
        ParameterError: as `robot_parameters`.
    """
    return NodeGraph(NODES, robot_parameters(options), namespace=options.namespace)


def _apply(parameters: Parameters, options: RobotOptions) -> None:
    arm, pump = parameters["arm_node"], parameters["pump_node"]
    arm["backend"] = options.backend
    pump["backend"] = "mock" if options.backend == "mock" else "panda"
    if options.robot_ip:
        arm["panda.robot_ip"] = pump["robot_ip"] = options.robot_ip
    if options.model:
        parameters["inference_node"]["model_path"] = options.model
    if options.speed is not None:
        parameters["motion_node"]["safety.speed_scale"] = options.speed
    if options.dry_run:
        parameters["motion_node"]["safety.dry_run"] = True
    if options.start:
        parameters["policy_node"]["autostart"] = True


def _known(cls: type, given: dict[str, Any]) -> dict[str, Any]:
    names = {spec.name for spec in specifications(cls)}
    return {name: value for name, value in given.items() if name in names}
