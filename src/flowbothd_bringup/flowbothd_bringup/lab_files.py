"""A lab's parameter files, as they apply to the nodes of one graph."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from flowbothd_bringup.lab_values import checked_values
from flowbothd_bringup.node_graph import config_file
from flowbothd_common.errors import ParameterError
from flowbothd_common.parameter_files import (
    Parameters,
    as_written,
    astray,
    base_name,
    full_name,
    reaches,
    read_parameters,
    unreached,
)


def lab_parameters(
    path: Path, nodes: Collection[str], others: Collection[str] = (), namespace: str = ""
) -> Parameters:
    """Read a file and return what it says to each node that it reaches.

    A bare name means the node wherever the graph lives, a full name (``/left/motion_node``) that
    one node, wildcards what they mean to ROS; where several entries reach a node, the last wins.

    Args:
        path: A file, or the name of one that comes with this package.
        nodes: Nodes of the graph, without namespace.
        others: Nodes of the project's other graphs; a file may serve several graphs.
        namespace: Namespace of the graph; empty = the root.

    Raises:
        ParameterError: the file does not exist or is not a parameter file, no entry reaches a node
            of the graph, one entry reaches none although it can be meant for no other graph, or a
            value is not allowed.
    """
    given = read_parameters(_existing(path))
    written = {as_written(node): values for node, values in given.items()}
    full = {node: full_name(node, namespace) for node in nodes}
    stray = astray(list(written), list(full.values()))
    stray += [w for w in written if base_name(w) not in {*nodes, *others, "*", "**"}]
    reached = [w for w in written if any(reaches(w, name) for name in full.values())]
    if stray or not reached:
        # As they stand in the file: that is what has to be found and changed there.
        names = {as_written(node): node for node in given}
        raise unreached(path.name, [names[w] for w in stray or written], full.values())
    result: Parameters = {}
    for node in (*nodes, *others):
        name = full_name(node, namespace)
        for entry, values in written.items():
            if reaches(entry, name):
                result.setdefault(node, {}).update(values)
    return {node: checked_values(path.name, node, values) for node, values in result.items()}


def _existing(path: Path) -> Path:
    known = config_file(path.name)
    file = path if path.is_file() else known
    if not file.is_file():
        raise ParameterError(
            "the parameter file does not exist",
            got=str(path),
            allowed="a file, or the name of one that comes with flowbothd_bringup, as fr3.yaml",
        )
    return file
