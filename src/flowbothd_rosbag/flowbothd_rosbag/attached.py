"""What the recorder attached to a recording: parameters and weights by node, those of one graph."""

from __future__ import annotations

from typing import Any

import yaml

from flowbothd_common.parameter_files import Parameters, flat_parameters
from flowbothd_rosbag import about
from flowbothd_rosbag.lookup import by_node
from flowbothd_rosbag.metadata import BagError
from flowbothd_rosbag.reader import Bag
from flowbothd_rosbag.renamed import current_parameters


def stored_parameters(bag: Bag) -> Parameters:
    """Return the parameters of the recorded graph's nodes; empty if they are not in the recording.

    Their names are those of today, also in an older recording.

    Raises:
        BagError: they are not what the recorder writes, or those of several graphs.
    """
    found = {
        node: current_parameters(node, flat_parameters(entry["ros__parameters"]))
        for node, entry in _mapping(bag, about.PARAMETERS).items()
        if isinstance(entry, dict) and isinstance(entry.get("ros__parameters"), dict)
    }
    return by_node(bag, found)


def stored_weights(bag: Bag) -> dict[str, Any]:
    """Return what was recorded of the weights in use, by node; empty if that is not in it.

    Raises:
        BagError: it is not what the recorder writes, or that of several graphs.
    """
    return by_node(bag, _mapping(bag, about.WEIGHTS))


def _mapping(bag: Bag, name: str) -> dict[str, Any]:
    try:
        content = yaml.safe_load(bag.attachments().get(name, b"")) or {}
    except yaml.YAMLError as error:
        first = str(error).splitlines()[0]
        raise BagError(f"{name} in the recording is damaged", got=first) from error
    if not isinstance(content, dict):
        raise BagError(f"{name} in the recording is not what `flowbothd record` writes")
    return content
