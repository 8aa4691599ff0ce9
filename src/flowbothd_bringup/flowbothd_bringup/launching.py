"""Code shared by the launch files: the nodes of a graph as launch actions.

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

from flowbothd_bringup.node_graph import NodeGraph
from flowbothd_common.environment import node_environment
from flowbothd_common.parameter_files import write_parameters

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
    """Return True if a launch argument says yes."""
    return text.strip().lower() in ("true", "1", "yes", "on")


def description(
    arguments: Mapping[str, tuple[str, str]],
    graph: Callable[[Values], NodeGraph],
) -> Any:
    """A launch description.

    Args:
        arguments: Name -> default and description.
        graph: Takes the values of the arguments, and the namespace that a launch file around this
            one has pushed.
    """

    def start(context: Any) -> list[Any]:
        values = {name: LaunchConfiguration(name).perform(context) for name in arguments}
        # Set where a launch file includes this one below a PushRosNamespace.
        values[NAMESPACE] = LaunchConfiguration(NAMESPACE, default="").perform(context)
        described = graph(values)
        if values.get("record"):
            described = described.recorded(out=values["record"], profile=values["profile"])
        return node_actions(described)

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def node_actions(graph: NodeGraph) -> list[Any]:
    """Return actions that start the nodes of a graph, with the environment that they need.

    Their parameters are in a file that stays for as long as they may read it.
    """
    file = Path(tempfile.mkdtemp(prefix="flowbothd-")) / "parameters.yaml"
    write_parameters(file, graph.parameters)
    environment = node_environment(0)
    return [
        *(SetEnvironmentVariable(name, environment[name]) for name in _ENVIRONMENT),
        *(
            Node(
                package=module.split(".", maxsplit=1)[0],
                executable=name,
                name=name,
                namespace=graph.namespace_of(name) or None,
                output="screen",
                parameters=[str(file)],
                remappings=list(graph.remappings.items()),
            )
            for name, module in graph.nodes.items()
        ),
    ]
