"""The graph that plays a recording: the player, and perception if it is to run anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from flowbothd_bringup.bags.lookup import topic_called
from flowbothd_bringup.bags.metadata import BagError
from flowbothd_bringup.bags.reader import Bag
from flowbothd_bringup.graph import NODES, Parameters

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
) -> tuple[dict[str, str], Parameters]:
    """Node -> module, and their parameters.

    Args:
        path: The recording.
        rate: Speed.
        begin: Where to begin, after the first message [s].
        end: Where to end [s]; 0 = at its end.
        loop: Begin anew at the end.
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
    nodes = {PLAYER: "flowbothd_bringup.replay.player_node"}
    parameters: Parameters = {PLAYER: player}
    if perception:
        nodes[PERCEPTION] = NODES[PERCEPTION]
        parameters[PERCEPTION] = recorded_parameters(bag, PERCEPTION)
        left_out.append(_OUTPUT)
        inputs = [topic_called(bag, name) for name in _INPUTS]
        player["wait_for"] = [name for name in inputs if name is not None]
    if left_out:
        player["exclude"] = "|".join(left_out)
    return nodes, parameters


def recorded_parameters(bag: Bag, node: str) -> dict[str, Any]:
    """Parameters that a node had, for its next run on the time of the recording.

    Raises:
        BagError: they were not recorded.
    """
    # Imports ROS, which the command line must not need before it knows its command.
    from flowbothd_bringup.replay.story import stored_parameters

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
