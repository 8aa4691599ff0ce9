"""The node graph: which processes, with which parameters."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from flowbothd_bringup.processes import NodeProcess
from flowbothd_bringup.scenes import Scene
from flowbothd_common.errors import ParameterError
from flowbothd_common.parameter_files import base_name, read_entries
from flowbothd_common.parameters import build, specifications
from franka_suction_driver.params import MotionParams
from sim_bridge.objects.registry import load_object

NODES = {
    "bridge_node": "sim_bridge.bridge_node",
    "motion_node": "franka_suction_driver.motion_node",
    "suction_node": "franka_suction_driver.suction_node",
    "perception_node": "flowbothd_perception.perception_node",
    "inference_node": "flowbothd_policy.inference_node",
    "policy_node": "flowbothd_policy.policy_node",
}
"""Node name -> module that runs it, for the graph against the simulation."""

Parameters = dict[str, dict[str, Any]]
"""Node name -> parameter name -> value."""

_ANYWHERE = "/**/"
"""Before the name of a node: in the root and under every namespace."""


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


def read_parameters(path: Path) -> Parameters:
    """Read a ROS YAML file: node -> name -> value, groups flattened to dotted names.

    ``motion_node`` and ``/**/motion_node`` are both returned as ``motion_node``, the node of that
    name wherever the graph lives. Other names, such as ``/left/motion_node`` and ``/**``, are
    returned as they are written.

    Raises:
        ParameterError: it is not a parameter file, or has two entries for one node.
    """
    result: Parameters = {}
    for written, values in read_entries(path).items():
        node = written if "/" in written.removeprefix(_ANYWHERE) else base_name(written)
        if node in result:
            raise ParameterError(
                f"{path.name} has two entries for {node}",
                got=f"{node} and {_ANYWHERE}{node}",
                hint="write them as one",
            )
        result[node] = values
    return result


def as_written(node: str) -> str:
    """Name of a node in parameter files: a bare name means the node wherever the graph lives."""
    return node if "/" in node else _ANYWHERE + node


class _PlainDumper(yaml.SafeDumper):
    """ROS refuses YAML in which one list stands for two parameters."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write equal lists twice."""
        return True


def write_parameters(path: Path, parameters: Parameters) -> None:
    """Write parameters as a ROS YAML file that applies in the root and under any namespace."""
    content = {as_written(node): {"ros__parameters": values} for node, values in parameters.items()}
    # In the given order: where several entries reach a node, ROS lets the last one win.
    path.write_text(yaml.dump(content, Dumper=_PlainDumper, sort_keys=False))


def check_object(scene: Scene, options: RunOptions) -> None:
    """Load the object once, so that what is wrong with it is said before six processes start.

    Raises:
        ObjectModelError: an unknown mode, or files that are missing or damaged.
    """
    load_object(scene.object, mode=options.mode or None, seed=options.seed)


def sim_motion_params() -> MotionParams:
    """Parameters of the motion core in simulation, as `up sim` gives them to motion_node."""
    given = read_parameters(config_file("sim.yaml"))["motion_node"]
    known = {spec.name for spec in specifications(MotionParams)}
    return build(MotionParams, {name: v for name, v in given.items() if name in known})


def config_file(name: str) -> Path:
    """A parameter file that comes with this package."""
    return Path(str(files("flowbothd_bringup") / "config" / name))


def sim_parameters(scene: Scene, options: RunOptions) -> Parameters:
    """Parameters of every node for one scene: config/sim.yaml, then the scene, then overrides."""
    result = read_parameters(config_file("sim.yaml"))
    for node in NODES:
        result.setdefault(node, {})
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
