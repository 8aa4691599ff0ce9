"""The graph against the simulation: its nodes and their parameters."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from flowbothd_bringup.node_graph import DECIDING_NODES, NodeGraph, config_file
from flowbothd_common.errors import ParameterError
from flowbothd_common.parameter_files import Parameters, read_parameters
from franka_suction_driver.simulated import SIMULATED_ARM
from sim_bridge.objects.registry import load_object
from sim_bridge.oracle import ORACLES
from sim_bridge.scenes import Scene

NODES = {"bridge_node": "sim_bridge.bridge_node", **DECIDING_NODES}
"""Node name -> module that runs it, for the graph in which a network predicts."""

MODEL = "model"
PREDICTORS = (MODEL, *ORACLES)
"""Predictors of the graph: a network in inference_node, or the simulation in oracle_node."""

INFERENCE, ORACLE = "inference_node", "oracle_node"


def sim_nodes(predictor: str) -> dict[str, str]:
    """Return node name -> module of the graph in which `predictor` answers `predict_flow`.

    Raises:
        ParameterError: an unknown predictor.
    """
    if predictor not in PREDICTORS:
        raise ParameterError("unknown predictor", got=predictor, allowed=", ".join(PREDICTORS))
    if predictor == MODEL:
        return dict(NODES)
    oracle = (ORACLE, "sim_bridge.oracle_node")
    return dict(oracle if name == INFERENCE else (name, module) for name, module in NODES.items())


@dataclass(frozen=True)
class RunOptions:
    """Options of one run.

    Attributes:
        seed: Run seed: mode, sensor noise, cloud sampling, prediction samples.
        mode: Mode of an object with modes; empty = drawn from the seed.
        predictor: One of `PREDICTORS`.
        model: Name, folder or file of the weights, for predictor model; empty = those of sim.yaml.
        start: Whether the policy starts by itself as soon as everything is there.
        overrides: Further parameters, on top of everything else.
    """

    seed: int = 0
    mode: str = ""
    predictor: str = "model"
    model: str = ""
    start: bool = False
    overrides: Parameters | None = None


def check_object(scene: Scene, options: RunOptions) -> None:
    """Load the object once, so that what is wrong with it is said before six processes start.

    Raises:
        ObjectModelError: an unknown mode, or files that are missing or damaged.
    """
    load_object(scene.object, mode=options.mode or None, seed=options.seed)


def sim_parameters(scene: Scene, options: RunOptions) -> Parameters:
    """Return the parameters of every node for one scene: files, then scene, then overrides.

    Raises:
        ParameterError: an unknown predictor.
    """
    result = read_parameters(config_file("sim.yaml"))
    nodes = sim_nodes(options.predictor)
    for node in nodes:
        result.setdefault(node, {})
    for node, values in read_parameters(SIMULATED_ARM).items():
        result[node] = values | result[node]
    camera = {
        "camera.position": list(scene.camera_eye),
        "camera.quaternion": scene.camera_quaternion,
    }
    result["bridge_node"] |= camera | {"object": scene.object, "seed": options.seed}
    if scene.position is not None:
        result["bridge_node"] |= {
            "object_position": list(scene.position),
            "object_yaw": scene.yaw,
        }
    if options.mode:
        result["bridge_node"]["mode"] = options.mode
    result["motion_node"]["camera_position"] = list(scene.camera_eye)
    result["perception_node"] |= camera | {"seed": options.seed}
    if options.predictor == MODEL:
        result[INFERENCE] |= {"model_path": options.model} if options.model else {}
    else:
        result[ORACLE]["predictor"] = options.predictor
    result["policy_node"] |= scene.policy | {"seed": options.seed, "autostart": options.start}
    for node, values in (options.overrides or {}).items():
        result.setdefault(node, {}).update(values)
    return _watching(result, nodes)


def _watching(parameters: Parameters, nodes: Collection[str]) -> Parameters:
    """Return the parameters of `nodes`; whoever watches the predictor watches the one that runs."""
    server = ORACLE if ORACLE in nodes else INFERENCE

    def renamed(value: Any) -> Any:
        if not isinstance(value, list):
            return value
        return [server if name in (INFERENCE, ORACLE) else name for name in value]

    return {
        node: {name: renamed(value) for name, value in values.items()}
        for node, values in parameters.items()
        if node in nodes or node not in (INFERENCE, ORACLE)
    }


def sim_graph(scene: Scene, options: RunOptions) -> NodeGraph:
    """Return the graph against the simulation of one scene."""
    return NodeGraph(sim_nodes(options.predictor), sim_parameters(scene, options))
