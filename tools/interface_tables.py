"""Write the generated tables of docs/ and README.md from the nodes and their parameters.

Run by `make docs`; tests/test_interface_docs.py fails when the files differ from what this makes.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from flowbothd_bringup import robot_graph, sim_graph
from flowbothd_common.markdown import markdown_table

ROOT = Path(__file__).resolve().parent.parent
INTERFACES = ROOT / "docs" / "reference" / "interfaces.md"
PARAMETERS = ROOT / "docs" / "reference" / "parameters.md"
README = ROOT / "README.md"

NODES = tuple({**sim_graph.NODES, **sim_graph.sim_nodes("oracle"), **robot_graph.NODES}.values())
# What has no default: a node refuses to start without it, here it gets something to start with.
REQUIRED: dict[str, dict[str, Any]] = {
    "flowbothd_perception.perception_node": {
        "camera.position": [0.0, 0.0, 0.0],
        "camera.quaternion": [0.0, 0.0, 0.0, 1.0],
    },
    "flowbothd_policy.inference_node": {"model_path": "compact-procedural"},
}
# What every ROS node has and no reader asks about.
COMMON = (
    "rosout",
    "parameter_events",
    "type_description",
    "transition_event",
    "_parameters",
    "parameter_types",
)
COMMON_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides")
_PARAMETER_HEAD = ("parameter", "type", "default", "allowed", "meaning")
LIFECYCLE = ("change_state", "get_state", "get_available_", "get_transition_graph")


def nodes() -> Iterator[Any]:
    """Yield one instance of every node, spinning nothing."""
    import rclpy
    from lifecycle_msgs.msg import State
    from rclpy.context import Context
    from rclpy.lifecycle import LifecycleNode
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    context = Context()
    rclpy.init(context=context, domain_id=100)
    try:
        for name in NODES:
            module = importlib.import_module(name)
            classes = [
                value
                for _, value in inspect.getmembers(module, inspect.isclass)
                if issubclass(value, Node) and value.__module__ == name
            ]
            overrides = [Parameter(n, value=v) for n, v in REQUIRED.get(name, {}).items()]
            node = classes[0](context=context, parameter_overrides=overrides)
            if isinstance(node, LifecycleNode) and node._state_machine.current_state[0] == (
                State.PRIMARY_STATE_UNCONFIGURED
            ):
                node.trigger_configure()
            yield node
            node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def type_name(kind: type) -> str:
    """`package/Name` of a message, service or action class."""
    return f"{kind.__module__.split('.')[0]}/{kind.__name__}"


def actions(found: list[tuple[str, list[str]]]) -> list[tuple[str, str]]:
    """(name, `package/Name`) of actions as the ROS graph reports them."""
    return [(name, types[0].replace("/action/", "/")) for name, types in found]


def endpoints(node: Any) -> dict[str, list[tuple[str, str]]]:
    """Topics, services and actions of a node: kind -> (name, type), names as in the code."""
    from rclpy.action import graph

    # Actions of the node itself are in its graph as soon as they are made.
    named = node, node.get_name(), node.get_namespace()
    found = {
        "publishes": [(p.topic_name, type_name(p.msg_type)) for p in node.publishers],
        "subscribes": [(s.topic_name, type_name(s.msg_type)) for s in node.subscriptions],
        "serves": [(s.srv_name, type_name(s.srv_type)) for s in node.services],
        "calls": [(c.srv_name, type_name(c.srv_type)) for c in node.clients],
        "action server": actions(graph.get_action_server_names_and_types_by_node(*named)),
        "action client": actions(graph.get_action_client_names_and_types_by_node(*named)),
    }
    # Only two topics are absolute by decision; everything else follows the node's namespace.
    absolute = ("/clock", "/diagnostics")
    private = f"/{node.get_name()}/"

    def shown(name: str) -> str:
        if name.startswith(private):
            return "~/" + name.removeprefix(private)
        return name if name in absolute else name.removeprefix("/")

    def wanted(name: str) -> bool:
        return not any(word in name for word in (*COMMON, *LIFECYCLE, "/_action/"))

    return {
        kind: sorted({(shown(n), t) for n, t in pairs if wanted(n)})
        for kind, pairs in found.items()
    }


def plain(value: object) -> str:
    """A value as documentation shows it: no digits that nobody needs."""
    return f"{value:.6g}" if isinstance(value, float) else f"{value}"


def parameter_rows(node: Any) -> list[list[str]]:
    """One row a parameter: name, type, default, allowed, description."""
    type_names = {1: "bool", 2: "integer", 3: "double", 4: "string"} | {
        6: "bool[]",
        7: "integer[]",
        8: "double[]",
        9: "string[]",
    }
    required = [
        parameter
        for module, given in REQUIRED.items()
        if module.endswith("." + node.get_name())
        for parameter in given
    ]
    rows = []
    for name in sorted(node._parameters):
        if name.startswith(COMMON_PARAMETERS):
            continue
        descriptor, value = node.describe_parameter(name), node._parameters[name].value
        is_array = value is not None and not isinstance(value, str) and hasattr(value, "__len__")
        shown = "[" + ", ".join(map(plain, value)) + "]" if is_array else plain(value)
        if name in required:
            shown = "required"
        live = "" if descriptor.read_only else " (live)"
        rows.append(
            [
                f"`{name}`",
                type_names.get(descriptor.type, "string[]") + live,
                f"`{shown}`" if value not in (None, "") else "",
                descriptor.additional_constraints,
                descriptor.description,
            ]
        )
    return rows


def render() -> tuple[str, str, str]:
    """Return the tables of interfaces.md and of parameters.md, and the node table of README.md."""
    detailed: list[str] = []
    parameters: list[str] = []
    summary: list[list[str]] = []
    for node in nodes():
        name = node.get_name()
        found = endpoints(node)
        detailed += [f"### {name}", ""]
        rows = [[kind, f"`{n}`", t] for kind, pairs in found.items() for n, t in pairs]
        detailed += [markdown_table(("", "name", "type"), rows), ""]
        parameters += [f"### {name}", "", markdown_table(_PARAMETER_HEAD, parameter_rows(node)), ""]

        def names(*kinds: str, found: dict[str, list[tuple[str, str]]] = found) -> str:
            hidden = ("heartbeat", "/diagnostics", "/clock")
            return " ".join(f"`{n}`" for k in kinds for n, _ in found[k] if n not in hidden)

        summary.append(
            [
                f"`{name}`",
                names("subscribes"),
                names("publishes"),
                names("serves", "action server"),
            ]
        )
    header = ("node", "subscribes", "publishes", "services and actions")
    parameters += recording_tables()
    return (
        "\n".join(detailed).rstrip(),
        "\n".join(parameters).rstrip(),
        markdown_table(header, summary),
    )


def replaced(path: Path, marker: str, text: str) -> str:
    """Content of the file with the part between the markers replaced."""
    begin, end = f"<!-- begin {marker} -->", f"<!-- end {marker} -->"
    content = path.read_text()
    if begin not in content or end not in content:
        raise SystemExit(f"{path.name} lacks the markers {begin} and {end}")
    return content.split(begin)[0] + begin + "\n" + text + "\n" + end + content.split(end)[1]


def dataclass_table(params: type) -> str:
    """Table of a parameter dataclass, for nodes that are not part of the robot's graph."""
    from flowbothd_common.parameters import specifications

    rows = []
    for spec in specifications(params):
        default = spec.default
        shown = ", ".join(map(plain, default)) if isinstance(default, tuple) else plain(default)
        shown = shown.lower() if isinstance(default, bool) else shown
        rows.append(
            [
                f"`{spec.name}`",
                spec.type_name,
                f"`{shown}`" if shown else "",
                spec.allowed,
                spec.description,
            ]
        )
    return markdown_table(_PARAMETER_HEAD, rows)


def recording_tables() -> list[str]:
    """Parameter tables of recorder and player."""
    from flowbothd_rosbag.player_params import PlayerParams
    from flowbothd_rosbag.recorder_params import RecorderParams

    lines = []
    for name, params in (("recorder_node", RecorderParams), ("player_node", PlayerParams)):
        lines += [f"### {name}", "", dataclass_table(params), ""]
    return lines


def documents() -> dict[Path, str]:
    """Path -> content that it should have."""
    detailed, parameters, summary = render()
    return {
        INTERFACES: replaced(INTERFACES, "node tables", detailed),
        PARAMETERS: replaced(PARAMETERS, "parameter tables", parameters),
        README: replaced(README, "node table", summary),
    }


if __name__ == "__main__":
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    for document, content in documents().items():
        document.write_text(content)
