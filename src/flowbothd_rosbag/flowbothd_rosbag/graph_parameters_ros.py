"""Asks every node of a graph for its parameters, by futures."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future

Values = dict[str, Any]


_PATIENCE = 3.0
"""Seconds after which a node that did not answer is asked again: it may have been too young."""


class GraphParameters:
    """Keeps the parameters of all nodes that answer.

    Args:
        node: Whose executor serves the futures; it is not asked itself.
        changed: Called whenever more is known, with node -> parameter -> value.
    """

    def __init__(self, node: Node, changed: Callable[[dict[str, Values]], None]) -> None:
        self._node, self._changed = node, changed
        self._asked: dict[str, float] = {}
        self._values: dict[str, Values] = {}
        self._clients: dict[str, tuple[Client, Client]] = {}

    def look(self) -> None:
        """Ask nodes that have not answered yet and are ready to."""
        now = time.monotonic()
        for name, namespace in self._node.get_node_names_and_namespaces():
            full = f"{namespace.rstrip('/')}/{name}"
            if name.startswith("_") or name == self._node.get_name() or full in self._values:
                continue
            if now - self._asked.get(full, -_PATIENCE) >= _PATIENCE and self._ask(full):
                self._asked[full] = now

    def _ask(self, full: str) -> bool:
        if full not in self._clients:
            self._clients[full] = (
                self._node.create_client(ListParameters, f"{full}/list_parameters"),
                self._node.create_client(GetParameters, f"{full}/get_parameters"),
            )
        names, values = self._clients[full]
        if not (names.service_is_ready() and values.service_is_ready()):
            return False

        names.call_async(ListParameters.Request()).add_done_callback(
            lambda future: self._read(full, values, [list(future.result().result.names)], {})
        )
        return True

    def _read(self, full: str, client: Client, todo: list[list[str]], known: Values) -> None:
        """Ask for the values of one group of names after the other.

        One parameter without a value makes rclpy keep back those of the whole request, so a group
        that is refused is halved. One request at a time: a service keeps no more than ten.
        """
        if not todo:
            self._values[full] = known
            self._changed({name.lstrip("/"): values for name, values in self._values.items()})
            return
        names, rest = todo[0], todo[1:]

        def told(future: Future) -> None:
            answer = future.result().values
            if len(answer) == len(names):
                more = {name: _plain(v) for name, v in zip(names, answer, strict=True)}
                self._read(full, client, rest, known | more)
            elif len(names) > 1:
                middle = len(names) // 2
                self._read(full, client, [names[:middle], names[middle:], *rest], known)
            else:
                self._read(full, client, rest, known)

        client.call_async(GetParameters.Request(names=names)).add_done_callback(told)


def _plain(value: ParameterValue) -> Any:
    python = parameter_value_to_python(value)
    return list(python) if hasattr(python, "tolist") or isinstance(python, tuple) else python
