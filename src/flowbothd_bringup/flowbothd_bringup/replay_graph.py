"""The graph that plays a recording: the player, and perception if it is to run again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from flowbothd_bringup.node_graph import DECIDING_NODES, NodeGraph
from flowbothd_common.parameter_files import Parameters
from flowbothd_rosbag.attached import stored_parameters
from flowbothd_rosbag.lookup import graph_namespace, topic_called
from flowbothd_rosbag.metadata import BagError
from flowbothd_rosbag.reader import Bag

PLAYER = "player_node"
PERCEPTION = "perception_node"

_OUTPUT = r"/object_cloud$|/perception_node/"
_INPUTS = ("joint_states", "depth/image_raw")


def playing_graph(
    path: Path,
    *,
    rate: float = 1.0,
    begin: float = 0.0,
    end: float = 0.0,
    loop: bool = False,
    exclude: str = "",
    perception: bool = False,
    namespace: str | None = None,
) -> NodeGraph:
    """Return the graph that plays a recording.

    Args:
        path: The recording.
        rate: Speed.
        begin: Where to begin, after the first message [s].
        end: Where to end [s]; 0 = at its end.
        loop: Start over at the end.
        exclude: Regular expression of topics that are not played.
        perception: Run perception_node as it was configured, and play all but what it put out.
        namespace: Graph whose perception_node it is, where several were recorded.

    Raises:
        BagError: there is no recording, or it lacks the parameters of a node that is to run.
    """
    bag = Bag(path, namespace)
    if rate <= 0:
        raise BagError("rate of a replay", got=rate, allowed="> 0")
    left_out = [exclude] if exclude else []
    player: dict[str, Any] = {
        "bag": str(path),
        "rate": float(rate),
        "begin": float(begin),
        "end": float(end),
        "loop": loop,
    }
    nodes = {PLAYER: "flowbothd_rosbag.player_node"}
    parameters: Parameters = {PLAYER: player}
    space = ""
    if perception:
        space = graph_namespace(bag) or ""
        nodes[PERCEPTION] = DECIDING_NODES[PERCEPTION]
        parameters[PERCEPTION] = recorded_parameters(bag, PERCEPTION)
        left_out.append(_OUTPUT)
        inputs = [topic_called(bag, name) for name in _INPUTS]
        player["wait_for"] = [name for name in inputs if name is not None]
    if left_out:
        player["exclude"] = "|".join(left_out)
    # The topics of the player have full names; the others listen where the graph was.
    return NodeGraph(nodes, parameters, namespace=space, in_root=(PLAYER,))


def recorded_parameters(bag: Bag, node: str) -> dict[str, Any]:
    """Parameters that a node had, for its next run on the time of the recording.

    Raises:
        BagError: they were not recorded.
    """
    values = stored_parameters(bag).get(node)
    if values is None:
        raise BagError(
            f"{bag.path} has no parameters of {node}",
            hint="record with `flowbothd record`, which asks all nodes for theirs",
        )
    kept = {
        name: value
        for name, value in values.items()
        if not name.startswith(("qos_overrides", "start_type_description")) and value != []
    }
    return kept | {"use_sim_time": True}
