"""Declares a parameter dataclass on a node and keeps it validated."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from flowbothd_common.errors import ParameterError
from flowbothd_common.parameter_files import astray, missing_entry, reaches, read_entries
from flowbothd_common.parameters import Specification, build, checked, specifications

T = TypeVar("T")

_ROS_TYPES = {
    (bool, False): Parameter.Type.BOOL,
    (int, False): Parameter.Type.INTEGER,
    (float, False): Parameter.Type.DOUBLE,
    (str, False): Parameter.Type.STRING,
    (bool, True): Parameter.Type.BOOL_ARRAY,
    (int, True): Parameter.Type.INTEGER_ARRAY,
    (float, True): Parameter.Type.DOUBLE_ARRAY,
    (str, True): Parameter.Type.STRING_ARRAY,
}


def _descriptor(spec: Specification) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=spec.description,
        additional_constraints=spec.allowed,
        read_only=spec.read_only,
    )
    # Ranges of arrays are checked by us alone: ROS knows ranges only for single numbers.
    bounded = spec.minimum is not None or spec.maximum is not None
    if bounded and spec.kind is float and not isinstance(spec.default, tuple):
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=-1e308 if spec.minimum is None else float(spec.minimum),
                to_value=1e308 if spec.maximum is None else float(spec.maximum),
            )
        ]
    if bounded and spec.kind is int and not isinstance(spec.default, tuple):
        descriptor.integer_range = [
            IntegerRange(
                from_value=-(2**63) if spec.minimum is None else int(spec.minimum),
                to_value=2**63 - 1 if spec.maximum is None else int(spec.maximum),
                step=1,
            )
        ]
    return descriptor


def _declare_one(node: Node, spec: Specification) -> Any:
    is_array = isinstance(spec.default, tuple)
    # An empty array needs its type named: rclpy would take an empty list for bytes.
    value: Any = list(spec.default) if isinstance(spec.default, tuple) else spec.default
    declared_as = _ROS_TYPES[spec.kind, is_array] if value == [] else value
    try:
        declared = node.declare_parameter(spec.name, declared_as, _descriptor(spec))
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        override = node._parameter_overrides.get(spec.name)
        given = value if override is None else override.value
        # Ours says which of type, range and finiteness it is; it accepts `1` for a double.
        checked(spec, given)
        raise ParameterError(
            f"parameter {spec.name} of {node.get_name()} is not accepted",
            got=repr(given),
            allowed=f"{spec.type_name} {spec.allowed}".strip(),
            hint="a double needs a decimal point in YAML, such as 1.0",
        ) from error
    if declared.type_ == Parameter.Type.NOT_SET:
        return spec.default
    return checked(spec, list(declared.value) if is_array else declared.value)


def declare(node: Node, cls: type[T]) -> T:
    """Declare every parameter of `cls` on the node and return the dataclass with its values.

    Raises:
        ParameterError: an override has the wrong type or lies outside its range; it says what
            was given and what is allowed.
    """
    return build(cls, {spec.name: _declare_one(node, spec) for spec in specifications(cls)})


def reject_unknown(node: Node) -> None:
    """Refuse overrides that no parameter of the node answers to; they are typing mistakes.

    Raises:
        ParameterError: an unknown name; the nearest known ones are listed.
    """
    for name in node._parameter_overrides:
        if not node.has_parameter(name) and not name.startswith("qos_overrides."):
            known = list(node._parameters)
            near = difflib.get_close_matches(name, known, n=3) or sorted(known)
            raise ParameterError(
                f"{node.get_name()} has no parameter {name}", allowed=", ".join(near)
            )


def given_files(arguments: Sequence[str]) -> list[Path]:
    """Return the parameter files that ROS arguments name (`--ros-args --params-file FILE`)."""
    files, inside = [], False
    for word, following in pairwise(arguments):
        if word in ("--ros-args", "--"):
            inside = word == "--ros-args"
        elif inside and word == "--params-file":
            files.append(Path(following))
    return files


def check_files(node: Node, arguments: Sequence[str], *, strict: bool) -> None:
    """Find parameter files that say nothing to the node they are given to.

    ROS passes over entries for other nodes. That is right for a file that serves several nodes,
    and hides a misspelt name, or a bare one under a namespace.

    Args:
        node: As it was created, its name and namespace remapped.
        arguments: Command line of the process.
        strict: Refuse such a file; otherwise warn.

    Raises:
        ParameterError: strict, and no entry of a file reaches the node, or only wildcards do while
            an entry of the node's own name misses it.
    """
    name = node.get_fully_qualified_name()
    for file in given_files(arguments):
        written = list(read_entries(file))
        if any(reaches(entry, name) for entry in written) and not astray(written, [name]):
            continue
        error = missing_entry(file.name, written, name)
        if strict:
            raise error
        node.get_logger().warning(str(error))
