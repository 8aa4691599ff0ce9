"""A graph of nodes: what runs, with which parameters, under which names.

The command line starts it as processes, launch files as launch actions.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from flowbothd_common.parameter_files import Parameters, write_parameters

DECIDING_NODES = {
    "perception_node": "flowbothd_perception.perception_node",
    "inference_node": "flowbothd_policy.inference_node",
    "policy_node": "flowbothd_policy.policy_node",
    "motion_node": "franka_suction_driver.motion_node",
    "suction_node": "franka_suction_driver.suction.suction_node",
}
"""Node name -> module that runs it: what is the same against a simulation and on a robot."""

RECORDER = "recorder_node"


@dataclass(frozen=True)
class NodeProcess:
    """One process of a graph.

    Attributes:
        name: Shown before each of its lines.
        command: Program and arguments.
        required: The whole graph stops when this one ends, with its exit status.
    """

    name: str
    command: tuple[str, ...]
    required: bool = False


@dataclass(frozen=True)
class NodeGraph:
    """Nodes that run together.

    Attributes:
        nodes: Node name -> module that runs it. The executable has the node's name.
        parameters: Of the nodes.
        remappings: Name of a topic, service or action in the code -> its name in this graph.
        namespace: ROS namespace, such as ``/left``; empty = the root.
        in_root: Nodes that stay in the root, because all their topics have full names.
    """

    nodes: Mapping[str, str]
    parameters: Parameters
    remappings: Mapping[str, str] = field(default_factory=dict)
    namespace: str = ""
    in_root: Collection[str] = ()

    def recorded(self, **parameters: Any) -> NodeGraph:
        """Return the graph with a recorder in it.

        Args:
            parameters: Of the recorder, on top of what the graph has for it.
        """
        given = self.parameters.get(RECORDER, {}) | parameters
        return replace(
            self,
            nodes={**self.nodes, RECORDER: "flowbothd_rosbag.recorder_node"},
            parameters={**self.parameters, RECORDER: given},
        )

    def namespace_of(self, node: str) -> str:
        """Return the namespace of one node; empty = the root."""
        return "" if node in self.in_root else self.namespace

    def processes(self, parameters_file: Path, required: Collection[str] = ()) -> list[NodeProcess]:
        """Write the parameters, and return a process for each node.

        Args:
            parameters_file: Is written; read by the processes when they start.
            required: Nodes whose end is the end of the whole graph.
        """
        write_parameters(parameters_file, self.parameters)
        common = ["--ros-args", "--params-file", str(parameters_file)]
        for name, to in self.remappings.items():
            common += ["-r", f"{name}:={to}"]
        result = []
        for name, module in self.nodes.items():
            space = self.namespace_of(name)
            arguments = [*common, *(("-r", f"__ns:={space}") if space else ())]
            command = (sys.executable, "-m", module, *arguments)
            result.append(NodeProcess(name, command, name in required))
        return result


def config_file(name: str) -> Path:
    """Path of a parameter file that comes with this package.

    It is next to the package in a source checkout, in share/flowbothd_bringup once installed.
    """
    package = Path(__file__).resolve().parent
    checkout = package.parent / "config" / name
    if (package.parent / "package.xml").is_file():
        return checkout
    shared = Path("share") / package.name / "config" / name
    installed = (folder / shared for folder in package.parents)
    return next((path for path in installed if path.is_file()), checkout)
