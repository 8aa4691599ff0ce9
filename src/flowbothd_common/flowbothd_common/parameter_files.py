"""ROS parameter files: read, written, and the nodes that each entry reaches.

ROS drops an entry that matches no node without a message, so that a misspelt name, or a bare name
under a namespace, leaves a node with its defaults. The functions here find such entries. Names are
matched as rcl does (Jazzy): ``/**/motion_node`` reaches the node of that name in the root and under
every namespace, ``/**`` reaches every node, ``/*/motion_node`` exactly one namespace; a name
without a leading slash is one in the root.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from flowbothd_common.errors import ParameterError

Parameters = dict[str, dict[str, Any]]
"""Node name -> parameter name -> value."""

Entries = dict[str, dict[str, Any]]
"""Name of the node as written, namespaces joined -> dotted parameter name -> value."""

_ANYWHERE = "/**/"
"""Before the name of a node: in the root and under every namespace."""
_PARAMETERS = "ros__parameters"
_TOKENS = {"**": r"(/\w+)*", "*": r"/\w+"}


class _UniqueKeys(yaml.SafeLoader):  # type: ignore[misc]
    """YAML in which no key is written twice: PyYAML would silently keep the last one."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Build a mapping; refuse a key that is there already."""
        keys = [key.value for key, _ in node.value if key.tag != "tag:yaml.org,2002:merge"]
        for key in keys:
            if keys.count(key) > 1:
                raise yaml.constructor.ConstructorError(
                    None, None, f"{key} is written twice", node.start_mark
                )
        result: dict[Any, Any] = super().construct_mapping(node, deep)
        return result


def read_entries(path: Path) -> Entries:
    """Read a parameter file; its entries in their order, groups flattened to dotted names.

    Raises:
        ParameterError: the file cannot be read, is not YAML, writes a key twice, or has something
            else where ROS expects node names and `ros__parameters`.
    """
    try:
        content = yaml.load(path.read_text(), _UniqueKeys)
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(f"the parameter file {path} cannot be read", got=error) from error
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise ParameterError(f"{path} is not a parameter file", got=reason) from error
    return dict(_entries(path, content or {}, ""))


def _entries(path: Path, content: object, prefix: str) -> Iterator[tuple[str, dict[str, Any]]]:
    if not isinstance(content, Mapping):
        raise ParameterError(
            f"{path} is not a parameter file",
            got=f"{prefix or 'at the top'}: {content!r}",
            allowed=f"NODE: {{{_PARAMETERS}: {{NAME: VALUE}}}}",
        )
    for name, inner in content.items():
        full = f"{prefix.rstrip('/')}/{name}" if prefix else str(name)
        if isinstance(inner, Mapping) and _PARAMETERS in inner:
            values = inner[_PARAMETERS]
            if not isinstance(values, Mapping):
                raise ParameterError(
                    f"{path}: {_PARAMETERS} of {full} is not a list of names and values",
                    got=repr(values),
                    allowed="NAME: VALUE lines, or {} for none",
                )
            yield full, flat_parameters(values)
            inner = {key: value for key, value in inner.items() if key != _PARAMETERS}
            if not inner:
                continue
        yield from _entries(path, inner, full)


def flat_parameters(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested groups of parameters as one level of dotted names."""
    result: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            result.update(flat_parameters(value, f"{prefix}{name}."))
        else:
            result[f"{prefix}{name}"] = value
    return result


def full_name(node: str, namespace: str = "") -> str:
    """Return the fully qualified name of a node, such as ``/left/motion_node``."""
    return "/" + "/".join(part for part in (namespace.strip("/"), node) if part)


def reaches(written: str, node: str) -> bool:
    """Say whether an entry applies to a node, as rcl decides it.

    Args:
        written: Name of the entry, wildcards ``*`` and ``**`` included.
        node: Fully qualified name.
    """
    tokens = written.removeprefix("/").split("/")
    pattern = "".join(_TOKENS.get(token, "/" + re.escape(token)) for token in tokens)
    return re.fullmatch(pattern, node) is not None


def base_name(written: str) -> str:
    """Return the last part of the name of an entry or node: the node's own name, or a wildcard."""
    return written.rsplit("/", maxsplit=1)[-1]


def astray(written: Sequence[str], nodes: Sequence[str]) -> list[str]:
    """Return the entries that were meant for one of the nodes, but reach none.

    An entry for a node of another name, or for a namesake in another namespace, may be meant for
    another graph. It was meant for one of these nodes if no entry of its name reaches them.

    Args:
        written: Names of all entries of a file.
        nodes: Fully qualified names of the nodes of a graph.
    """
    reached = {base_name(w) for w in written if any(reaches(w, node) for node in nodes)}
    meant = {base_name(node) for node in nodes} | set(_TOKENS)
    return [w for w in written if base_name(w) in meant - reached]


def unreached(file: str, written: Iterable[str], nodes: Iterable[str]) -> ParameterError:
    """Return the error for entries that reach no node of a graph.

    Args:
        file: Name of the file.
        written: Names of the entries.
        nodes: Fully qualified names of the nodes that there are.
    """
    names, full = list(written), sorted(nodes)
    return ParameterError(
        f"{file}: the parameters of {', '.join(names) or 'no node at all'} reach no node",
        allowed=", ".join(full),
        hint=f"write {_proposal(names, full)}: it applies in the root and under any namespace",
    )


def _proposal(written: Sequence[str], nodes: Sequence[str]) -> str:
    """Return the names that were probably meant."""
    known = {base_name(node).removesuffix("_node"): base_name(node) for node in nodes}
    near: dict[str, None] = {}
    for name in written:
        short = base_name(name).removesuffix("_node")
        for match in difflib.get_close_matches(short, known, n=1):
            near["/**/" + known[match]] = None
    return ", ".join(near) or "/**/NODE"


def missing_entry(file: str, written: Iterable[str], node: str) -> ParameterError:
    """Return the error for a node that is started with a file of which no entry reaches it.

    Args:
        file: Name of the file.
        written: Names of its entries.
        node: Fully qualified name of the node.
    """
    return ParameterError(
        f"{file} has no parameters for {node}",
        got=f"parameters of {', '.join(written) or 'no node at all'}",
        hint=f"write /**/{base_name(node)}, which applies in the root and under any namespace, or "
        "start the node without this file",
    )


def read_parameters(path: Path) -> Parameters:
    """Read a ROS YAML file: node -> name -> value, groups flattened to dotted names.

    ``motion_node`` and ``/**/motion_node`` are both returned as ``motion_node``, the node of that
    name wherever the graph lives. Other names, such as ``/left/motion_node`` and ``/**``, are
    returned as they are written.

    Raises:
        ParameterError: it is not a parameter file, or has two entries for one node.
    """
    result: Parameters = {}
    for written, values in read_entries(path).items():
        node = written if "/" in written.removeprefix(_ANYWHERE) else base_name(written)
        if node in result:
            raise ParameterError(
                f"{path.name} has two entries for {node}",
                got=f"{node} and {_ANYWHERE}{node}",
                hint="write them as one",
            )
        result[node] = values
    return result


def as_written(node: str) -> str:
    """Return the name of a node in parameter files: a bare name reaches it in any namespace."""
    return node if "/" in node else _ANYWHERE + node


class _PlainDumper(yaml.SafeDumper):  # type: ignore[misc]
    """ROS refuses YAML in which one list stands for two parameters."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write equal lists twice."""
        return True


def write_parameters(path: Path, parameters: Parameters) -> None:
    """Write parameters as a ROS YAML file that applies in the root and under any namespace."""
    content = {as_written(node): {"ros__parameters": values} for node, values in parameters.items()}
    # In the given order: where several entries reach a node, ROS lets the last one win.
    path.write_text(yaml.dump(content, Dumper=_PlainDumper, sort_keys=False))
