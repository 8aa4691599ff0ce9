"""Parameters as frozen dataclasses: described, bounded, validated, nested in dotted groups.

A node's parameters are one frozen dataclass whose fields are made by `parameter`. A field whose
default is itself such a dataclass is a group: its parameters are named ``group.name``. The same
class serves the ROS-free cores, the ROS declaration (`flowbothd_common.ros.parameters`) and the
tables in the documentation.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from flowbothd_common.errors import ParameterError

T = TypeVar("T")
Value = (
    bool
    | int
    | float
    | str
    | tuple[bool, ...]
    | tuple[int, ...]
    | tuple[float, ...]
    | tuple[str, ...]
)


@dataclass(frozen=True)
class Specification:
    """Declaration of one parameter.

    Attributes:
        name: Full dotted name.
        default: Its default; a tuple for arrays.
        description: For people, with the unit in brackets.
        minimum: Smallest allowed number (of every element), or None.
        maximum: Largest allowed number (of every element), or None.
        choices: Allowed values, or empty.
        length: Required number of elements of an array, or None.
        element: Type of the elements of an array that is empty by default.
        read_only: Whether it is fixed once the node runs.
    """

    name: str
    default: Value
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    length: int | None = None
    element: type | None = None
    read_only: bool = True

    @property
    def kind(self) -> type:
        """Type of the value, or of the elements where the value is a tuple."""
        if isinstance(self.default, tuple):
            if self.element is not None:
                return self.element
            return type(self.default[0]) if self.default else str
        return type(self.default)

    @property
    def type_name(self) -> str:
        """Name of the type as documentation shows it, such as ``double[]``."""
        name = {bool: "bool", int: "integer", float: "double", str: "string"}[self.kind]
        return name + "[]" if isinstance(self.default, tuple) else name

    @property
    def allowed(self) -> str:
        """Allowed values in words; empty if any value is allowed."""
        if self.choices:
            return ", ".join(self.choices)
        parts = []
        if self.minimum is not None or self.maximum is not None:
            low = "" if self.minimum is None else f"{self.minimum:g} <= "
            high = "" if self.maximum is None else f" <= {self.maximum:g}"
            parts.append(f"{low}x{high}")
        if self.length is not None:
            parts.append(f"{self.length} values")
        return ", ".join(parts)


def parameter(
    default: Value,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Sequence[str] = (),
    length: int | None = None,
    element: type | None = None,
    read_only: bool = True,
) -> Any:
    """Return a dataclass field that declares one parameter; see `Specification` for the words."""
    if not description:
        raise ValueError("a parameter needs a description")
    return dataclasses.field(
        default=default,
        metadata={
            "description": description,
            "minimum": minimum,
            "maximum": maximum,
            "choices": tuple(choices),
            "length": length,
            "element": element,
            "read_only": read_only,
        },
    )


def group(cls: type[T]) -> T:
    """Return a dataclass field that holds a group of parameters with its defaults."""
    return dataclasses.field(default_factory=cls)


def specifications(cls: type, prefix: str = "") -> Iterator[Specification]:
    """Yield the specification of every parameter of a parameter dataclass, in order."""
    defaults = cls()
    for item in dataclasses.fields(cls):
        value = getattr(defaults, item.name)
        if dataclasses.is_dataclass(value):
            yield from specifications(type(value), f"{prefix}{item.name}.")
        else:
            yield Specification(prefix + item.name, value, **item.metadata)


def _fits(kind: type, value: object) -> bool:
    if kind is float:
        # A whole number is accepted for a float from Python and from files; ROS itself is stricter.
        return isinstance(value, int | float) and not isinstance(value, bool)
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, kind)


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:
        # A whole number beyond every float; YAML has such.
        return False


def checked(spec: Specification, value: object) -> Value:
    """Return `value` in the type of the specification.

    Raises:
        ParameterError: wrong type, not finite, out of range, not among the choices, or of the
            wrong length.
    """
    is_array = isinstance(spec.default, tuple)
    if is_array != (isinstance(value, Sequence) and not isinstance(value, str)):
        raise ParameterError(
            f"parameter {spec.name} has the wrong type", got=repr(value), allowed=spec.type_name
        )
    elements: Sequence[Any] = value if is_array else (value,)  # type: ignore[assignment]
    for element in elements:
        if not _fits(spec.kind, element):
            raise ParameterError(
                f"parameter {spec.name} has the wrong type",
                got=repr(value),
                allowed=f"{spec.type_name} {spec.allowed}".strip(),
            )
        if spec.kind is float and not _is_finite(element):
            raise ParameterError(
                f"parameter {spec.name} is not finite",
                got=repr(value),
                allowed=", ".join(filter(None, ["finite numbers", spec.allowed])),
            )
        low = spec.minimum is not None and element < spec.minimum
        high = spec.maximum is not None and element > spec.maximum
        if low or high or (spec.choices and element not in spec.choices):
            raise ParameterError(
                f"parameter {spec.name} is out of range", got=repr(value), allowed=spec.allowed
            )
    if spec.length is not None and len(elements) != spec.length:
        raise ParameterError(
            f"parameter {spec.name} has the wrong length", got=len(elements), allowed=spec.length
        )
    converted = tuple(spec.kind(element) for element in elements)
    return converted if is_array else converted[0]


def build(cls: type[T], values: Mapping[str, object]) -> T:
    """Return the dataclass with `values` (by dotted name) in place of its defaults.

    Raises:
        ParameterError: an unknown name (the known ones are listed) or a value out of range.
    """
    specs = {spec.name: spec for spec in specifications(cls)}
    unknown = sorted(set(values) - set(specs))
    if unknown:
        raise ParameterError(
            "unknown parameters", got=", ".join(unknown), allowed=", ".join(sorted(specs))
        )
    return _assemble(cls, {name: checked(specs[name], value) for name, value in values.items()}, "")


def _assemble(cls: type[T], values: Mapping[str, object], prefix: str) -> T:
    defaults: Any = cls()
    changes: dict[str, Any] = {}
    for item in dataclasses.fields(defaults):
        default = getattr(defaults, item.name)
        name = prefix + item.name
        if dataclasses.is_dataclass(default):
            changes[item.name] = _assemble(type(default), values, name + ".")
        elif name in values:
            changes[item.name] = values[name]
    result: T = dataclasses.replace(defaults, **changes)
    return result


def flatten(instance: object, prefix: str = "") -> dict[str, Value]:
    """Return the values of a parameter dataclass by dotted name."""
    result: dict[str, Value] = {}
    for item in dataclasses.fields(instance):  # type: ignore[arg-type]
        value = getattr(instance, item.name)
        if dataclasses.is_dataclass(value):
            result.update(flatten(value, f"{prefix}{item.name}."))
        else:
            result[prefix + item.name] = value
    return result
