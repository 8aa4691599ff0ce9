"""The node graph: which processes, with which parameters."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from flowbothd_bringup.processes import NodeProcess
from flowbothd_common.parameter_files import Parameters, read_parameters
from franka_suction_driver.simulated import SIMULATED_ARM
from sim_bridge.objects.registry import load_object
from sim_bridge.scenes import Scene

NODES = {
    "bridge_node": "sim_bridge.bridge_node",
    "motion_node": "franka_suction_driver.motion_node",
    "suction_node": "franka_suction_driver.suction.suction_node",
    "perception_node": "flowbothd_perception.perception_node",
    "inference_node": "flowbothd_policy.inference_node",
    "policy_node": "flowbothd_policy.policy_node",
}
"""Node name -> module that runs it, for the graph against the simulation."""


@dataclass(frozen=True)
class RunOptions:
    """What differs from run to run.

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


def config_file(name: str) -> Path:
    """Path of a parameter file that comes with this package.

    It lies beside the package in a source checkout, in share/flowbothd_bringup once installed.
    """
    package = Path(__file__).resolve().parent
    checkout = package.parent / "config" / name
    if (package.parent / "package.xml").is_file():
        return checkout
    shared = Path("share") / package.name / "config" / name
    installed = (folder / shared for folder in package.parents)
    return next((path for path in installed if path.is_file()), checkout)


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


def sim_processes(parameters_file: Path, *, required: bool = False) -> list[NodeProcess]:
    """The processes of the graph against the simulation.

    Args:
        parameters_file: For all nodes.
        required: Whether the graph ends when any of them does.
    """
    return [
        NodeProcess(
            name,
            (sys.executable, "-m", module, "--ros-args", "--params-file", str(parameters_file)),
            required,
        )
        for name, module in NODES.items()
    ]
