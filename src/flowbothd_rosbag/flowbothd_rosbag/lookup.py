"""Topics and nodes of a recording by the end of their names, wherever its graph lived."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from typing import TypeVar

from flowbothd_rosbag.metadata import BagError
from flowbothd_rosbag.reader import Bag

T = TypeVar("T")

_OURS = "flowbothd_interfaces/msg/"
_MARKS = ("policy/decisions", "policy/events", "flow/prediction", "motion/result", "suction/state")
"""Topics that only a graph of this project has; what is before them is its namespace."""


def add_namespace(parser: argparse.ArgumentParser) -> None:
    """Add the argument that chooses one graph of several."""
    parser.add_argument(
        "--namespace",
        default=None,
        help="of the graph to look at, where the recording holds several (/ = the root)",
    )


def graph_namespace(bag: Bag) -> str | None:
    """Return the namespace of the recorded graph; empty = the root, None = there is no graph.

    Raises:
        BagError: the recording holds several graphs and none was chosen, or not the chosen one.
    """
    found = sorted(_namespaces(bag))
    if bag.namespace is not None:
        chosen = ("/" + bag.namespace.strip("/")).rstrip("/")
        if chosen and not any(name.startswith(chosen + "/") for name in bag.topics):
            raise BagError(
                f"{bag.path} holds nothing in the namespace",
                got=chosen,
                allowed=", ".join(space or "/" for space in found) or None,
            )
        return chosen
    if len(found) > 1:
        raise BagError(
            f"{bag.path} holds several graphs",
            got=", ".join(space or "/" for space in found),
            hint=f"choose one, such as --namespace {found[-1]}",
        )
    return found[0] if found else None


def topic_called(bag: Bag, name: str, kind: str = "") -> str | None:
    """Return the topic of a recording that ends in a relative name; None if there is none.

    Args:
        bag: The recording.
        name: Relative, such as ``policy/decisions``.
        kind: Its type; a topic of another one is somebody else's. Empty = any.

    Raises:
        BagError: there are several, and none of them is the recorded graph's.
    """
    found = [t.name for t in bag.topics.values() if kind in ("", t.type)]
    candidates = _candidates(bag, found, name)
    if len(candidates) > 1:
        raise BagError(
            f"{bag.path} has several topics called {name}",
            got=", ".join(candidates),
            hint="choose the namespace of one with --namespace",
        )
    return candidates[0] if candidates else None


def by_node(bag: Bag, content: Mapping[str, T]) -> dict[str, T]:
    """Return values by the node's own name from values by its full name, those of one graph.

    Raises:
        BagError: the recording holds several graphs and none was chosen.
    """
    full = {
        "/" + name.removeprefix("/").removeprefix("**/"): value for name, value in content.items()
    }
    result = {}
    for base in sorted({name.rsplit("/", maxsplit=1)[-1] for name in full}):
        candidates = _candidates(bag, full, base)
        if len(candidates) == 1:
            result[base] = full[candidates[0]]
    return result


def _namespaces(bag: Bag) -> set[str]:
    return {
        topic.name.removesuffix("/" + mark)
        for topic in bag.topics.values()
        for mark in _MARKS
        if topic.type.startswith(_OURS) and topic.name.endswith("/" + mark)
    }


def _candidates(bag: Bag, names: Iterable[str], end: str) -> list[str]:
    """Return the names that end so: the graph's own one if it is there, those near it otherwise."""
    found = [name for name in names if name.endswith("/" + end)]
    if bag.namespace is None and len(found) < 2:
        return found
    space = graph_namespace(bag)
    if space is None or f"{space}/{end}" in found:
        return found if space is None else [f"{space}/{end}"]
    others = _namespaces(bag) - {space}
    return [f for f in found if not any(other and f.startswith(other + "/") for other in others)]
