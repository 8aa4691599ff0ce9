"""The graph against the simulation: its nodes and their parameters."""

from __future__ import annotations

from dataclasses import dataclass

from flowbothd_bringup.node_graph import DECIDING_NODES, NodeGraph, config_file
from flowbothd_common.parameter_files import Parameters, read_parameters
from franka_suction_driver.simulated import SIMULATED_ARM
from sim_bridge.objects.registry import load_object
from sim_bridge.scenes import Scene

NODES = {"bridge_node": "sim_bridge.bridge_node", **DECIDING_NODES}
"""Node name -> module that runs it, for the graph against the simulation."""


@dataclass(frozen=True)
class RunOptions:
    """Options of one run.

    Attributes:
        seed: Run seed: mode, sensor noise, cloud sampling, prediction samples.
        mode: Mode of an object with modes; empty = drawn from the seed.
        predictor: oracle, ambiguous or model.
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
    """Parameters of every node for one scene: the files, then the scene, then overrides."""
    result = read_parameters(config_file("sim.yaml"))
    for node in NODES:
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
    result["inference_node"] |= {"predictor": options.predictor}
    if options.model:
        result["inference_node"]["model_path"] = options.model
    result["policy_node"] |= scene.policy | {"seed": options.seed, "autostart": options.start}
    for node, values in (options.overrides or {}).items():
        result.setdefault(node, {}).update(values)
    return result


def sim_graph(scene: Scene, options: RunOptions) -> NodeGraph:
    """Return the graph against the simulation of one scene."""
    return NodeGraph(NODES, sim_parameters(scene, options))
