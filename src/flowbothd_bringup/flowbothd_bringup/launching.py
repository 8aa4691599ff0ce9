"""What the launch files share: the nodes of a graph as launch actions, from the same parameters.

Only launch files import this: `launch` and `launch_ros` come with ROS from apt alone.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from launch import LaunchDescription  # type: ignore[attr-defined]
from launch.actions import (  # type: ignore[import-not-found]
    DeclareLaunchArgument,
    OpaqueFunction,
    SetEnvironmentVariable,
)
from launch.substitutions import LaunchConfiguration  # type: ignore[import-not-found]
from launch_ros.actions import Node  # type: ignore[import-not-found]

from flowbothd_bringup.environment import node_environment
from flowbothd_bringup.graph import Parameters, write_parameters

RECORDER = "flowbothd_bringup.bags.recorder_node"

RECORD = {
    "record": ("", "folder to record into; empty: record nothing"),
    "profile": ("light", "what is recorded: light, all or debug"),
}
"""Launch arguments of every graph that can be recorded."""

NAMESPACE = "ros_namespace"
"""Where launch_ros keeps the namespace of the nodes that are started."""

# Domain and discovery are the user's own; how messages travel and threads compute is the graph's.
_ENVIRONMENT = (
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
)

Values = dict[str, str]


def is_true(text: str) -> bool:
    """Whether a launch argument says yes."""
    return text.strip().lower() in ("true", "1", "yes", "on")


def description(
    arguments: Mapping[str, tuple[str, str]],
    graph: Callable[[Values], tuple[Mapping[str, str], Parameters]],
) -> Any:
    """A launch description.

    Args:
        arguments: Name -> default and description.
        graph: Takes the values of the arguments, and the namespace that a launch file around this
            one has pushed; gives node -> module, and parameters.
    """

    def start(context: Any) -> list[Any]:
        values = {name: LaunchConfiguration(name).perform(context) for name in arguments}
        # Set where a launch file includes this one below a PushRosNamespace.
        values[NAMESPACE] = LaunchConfiguration(NAMESPACE, default="").perform(context)
        nodes, parameters = graph(values)
        nodes, parameters = dict(nodes), dict(parameters)
        if values.get("record"):
            nodes["recorder_node"] = RECORDER
            recorder = {"out": values["record"], "profile": values["profile"]}
            parameters["recorder_node"] = {**parameters.get("recorder_node", {}), **recorder}
        return node_actions(nodes, parameters)

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def node_actions(nodes: Mapping[str, str], parameters: Parameters) -> list[Any]:
    """Actions that start nodes with parameters and with the environment that they need.

    Args:
        nodes: Node name -> module; the executable is called as the node.
        parameters: Of the nodes; written to a file that stays for as long as they may read it.
    """
    file = Path(tempfile.mkdtemp(prefix="flowbothd-")) / "parameters.yaml"
    write_parameters(file, parameters)
    environment = node_environment(0)
    return [
        *(SetEnvironmentVariable(name, environment[name]) for name in _ENVIRONMENT),
        *(
            Node(
                package=module.split(".", maxsplit=1)[0],
                executable=name,
                name=name,
                output="screen",
                parameters=[str(file)],
            )
            for name, module in nodes.items()
        ),
    ]
