"""Records as JSON: the one module that writes and reads them, old versions included.

A record is one JSON object that names its kind and version. Every field must be there, and have the
type that its dataclass declares: half a record is an error that says where it is, not a default.
"""

from __future__ import annotations

import functools
import gzip
import json
import types
import typing
from collections.abc import Hashable, Iterator
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from flowbothd_common.errors import ParameterError
from flowbothd_evaluation.records import ArmRecord, OpeningRecord, PaperRecord
from flowbothd_policy.commands import Decision

VERSION = 1
"""Of the records that are written; 0 are those from before records had a version."""


class Record(Protocol):
    """A dataclass that can be kept as one line of a file."""

    KIND: ClassVar[str]

    @property
    def key(self) -> Hashable:
        """By which the record of a piece of work is found again."""


R = TypeVar("R", bound=Record)
T = TypeVar("T")

RECORDS: dict[str, type[PaperRecord] | type[ArmRecord] | type[OpeningRecord]] = {
    kind.KIND: kind for kind in (PaperRecord, ArmRecord, OpeningRecord)
}
"""Kinds of records that a report is made of."""


class RecordError(ParameterError):
    """A line or a file is not the record that it should be."""


def as_plain(value: Any) -> Any:
    """Return the value with arrays as lists, enums as their values, dataclasses as dictionaries."""
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: as_plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, dict):
        return {str(k): as_plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [as_plain(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value.value if isinstance(value, Enum) else value


def to_json(record: Any, indent: int | None = None) -> str:
    """Return a record, a dataclass with a KIND, as JSON."""
    plain = {"record": record.KIND, "version": VERSION, **as_plain(record)}
    return json.dumps(plain, indent=indent)


def from_json(kind: type[T], text: str | bytes, where: str) -> T:
    """Return the record of a kind that `to_json` wrote, now or in an earlier version.

    Args:
        kind: A dataclass with a KIND.
        text: JSON.
        where: For errors: the file, and the line in it.

    Raises:
        RecordError: it is no record of this kind, of an unknown version, or a field is missing,
            unknown or of the wrong type.
    """
    name, plain = _header(text, where)
    wanted = str(getattr(kind, "KIND", ""))
    if name != wanted:
        raise RecordError(f"{where}: wrong kind of record", got=name, allowed=wanted)
    return typing.cast("T", _value(kind, plain, where, ""))


def write_json(path: Path, value: Any) -> None:
    """Write `value` as indented JSON, replacing the file in one move."""
    write_text(path, json.dumps(as_plain(value), indent=1) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a file, replacing an older one in one move."""
    temporary = path.with_suffix(path.suffix + ".part")
    temporary.write_text(text)
    temporary.replace(path)


def read_lines(path: Path) -> Iterator[tuple[bytes, str]]:
    """Yield the complete lines of a file, which may be compressed (.gz), and where they are.

    A last line without its end was cut off while it was written, and is left out.

    Raises:
        RecordError: the file cannot be read.
    """
    try:
        content = path.read_bytes()
        if path.suffix == ".gz":
            content = gzip.decompress(content)
    except (OSError, EOFError) as error:
        raise RecordError(f"{path} cannot be read", got=error) from error
    for number, line in enumerate(content.split(b"\n")[:-1], start=1):
        yield line, f"{path}, line {number}"


def read_records(path: Path, kind: type[R]) -> list[R]:
    """Return the records of one kind in a file; of a file that is not there, none.

    Raises:
        RecordError: see `from_json`.
    """
    if not path.exists():
        return []
    return [from_json(kind, line, where) for line, where in read_lines(path)]


def read_any(path: Path) -> list[PaperRecord | ArmRecord | OpeningRecord]:
    """Return the records of a file of whichever of RECORDS.

    Raises:
        RecordError: see `from_json`; or there are none.
    """
    found = []
    for line, where in read_lines(path):
        name, plain = _header(line, where)
        if name not in RECORDS:
            raise RecordError(f"{where}: no record to report", got=name, allowed=list(RECORDS))
        found.append(_value(RECORDS[name], plain, where, ""))
    if not found:
        raise RecordError(
            f"{path} holds no records", hint="give files that `flowbothd eval` has written"
        )
    return found


def _header(text: str | bytes, where: str) -> tuple[str, dict[str, Any]]:
    """Kind and fields of a record in the present version."""
    try:
        plain = json.loads(text)
    except ValueError:
        plain = None
    if not isinstance(plain, dict):
        shown = text.decode(errors="replace") if isinstance(text, bytes) else text
        raise RecordError(
            f"{where}: no record",
            got=shown[:60],
            hint="give a file that `flowbothd eval` has written, or another name to write to",
        )
    version = plain.pop("version", 0)
    if version == 0:
        return _from_version_0(plain, where)
    if version != VERSION:
        raise RecordError(
            f"{where}: unknown version of a record",
            got=version,
            allowed=f"0 to {VERSION}",
            hint="a newer flowbothd wrote it",
        )
    return str(plain.pop("record", "nothing")), plain


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


def _value(kind: Any, plain: Any, where: str, field: str) -> Any:
    """The value of a declared type that JSON has as `plain`."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return plain
    if origin in (types.UnionType, typing.Union):
        if plain is None and type(None) in arguments:
            return None
        (kind,) = (one for one in arguments if one is not type(None))
        return _value(kind, plain, where, field)
    if is_dataclass(kind):
        return _object(kind, plain, where, field)
    if origin is np.ndarray and isinstance(plain, list):
        return np.array(plain, dtype=float)
    if origin in (tuple, list) and isinstance(plain, list):
        return _sequence(origin, arguments, plain, where, field)
    if origin is dict and isinstance(plain, dict):
        inner = arguments[1]
        return {k: _value(inner, v, where, f"{field}.{k}") for k, v in plain.items()}
    if isinstance(kind, type) and issubclass(kind, Enum):
        allowed = [one.value for one in kind]
        if plain in allowed:
            return kind(plain)
        raise _wrong(where, field, plain, ", ".join(map(str, allowed)))
    if kind is float and isinstance(plain, int | float) and not isinstance(plain, bool):
        return float(plain)
    if kind in (bool, int, str) and type(plain) is kind:
        return plain
    raise _wrong(where, field, plain, getattr(kind, "__name__", str(kind)))


def _sequence(origin: Any, arguments: Any, plain: list[Any], where: str, field: str) -> Any:
    if origin is tuple and arguments[-1] is not Ellipsis:
        if len(plain) != len(arguments):
            raise _wrong(where, field, plain, f"{len(arguments)} values")
        inner = arguments
    else:
        inner = (arguments[0],) * len(plain)
    values = zip(inner, plain, strict=True)
    return origin(_value(k, v, where, f"{field}.{i}") for i, (k, v) in enumerate(values))


def _object(kind: Any, plain: Any, where: str, field: str) -> Any:
    if not isinstance(plain, dict):
        raise _wrong(where, field, plain, f"the fields of {kind.__name__}")
    hints = _hints(kind)
    prefix = f"{field}." if field else ""
    missing = [prefix + name for name in hints if name not in plain]
    if missing:
        raise RecordError(f"{where}: fields are missing", got=", ".join(missing))
    unknown = [prefix + name for name in plain if name not in hints]
    if unknown:
        raise RecordError(
            f"{where}: unknown fields", got=", ".join(unknown), allowed=", ".join(hints)
        )
    values = {n: _value(t, plain[n], where, prefix + n) for n, t in hints.items()}
    return kind(**values)


def _wrong(where: str, field: str, plain: Any, allowed: str) -> RecordError:
    return RecordError(f"{where}: field {field}", got=repr(plain)[:60], allowed=allowed)


_MARKS_0 = {
    "paper": {"target_mask", "per_step"},
    "arm": {"suite", "world"},
    "opening": {"task", "touches"},
    "places": {"task", "places"},
    "run": {"decisions", "states"},
}
"""Records of version 0 do not say of which kind they are: fields that no other kind has."""


def _from_version_0(plain: dict[str, Any], where: str) -> tuple[str, dict[str, Any]]:
    for kind, marks in _MARKS_0.items():
        if marks <= plain.keys():
            return kind, _CONVERSIONS_0.get(kind, dict)(plain)
    raise RecordError(
        f"{where}: no record",
        got=f"fields {', '.join(sorted(plain))}"[:200],
        hint="give a file that `flowbothd eval` has written",
    )


def _paper_0(plain: dict[str, Any]) -> dict[str, Any]:
    """Hashes of weights came later; times had no names that other experiments could share."""
    seconds = plain.get("seconds", {})
    return {
        "weights_sha256": "",
        **plain,
        "seconds": {
            "wall": seconds.get("total", 0.0),
            "simulated": 0.0,
            "predicting": seconds.get("predict", 0.0),
            "world": seconds.get("world", 0.0),
        },
    }


def _arm_0(plain: dict[str, Any]) -> dict[str, Any]:
    """A trial that failed with an error had no figures; the floating gripper no contacts."""
    figures = {"steps": 0, "grasps": 0, "resamples": 0, "open_ratio_left": 0.0, "peak_force": 0.0}
    plain = {**figures, "predictor": "", "contacts": {}, **plain}
    return _timed(plain)


def _timed(plain: dict[str, Any]) -> dict[str, Any]:
    wall, simulated = plain.pop("wall_s", 0.0), plain.pop("sim_s", 0.0)
    seconds = {"wall": wall, "simulated": simulated, "predicting": 0.0, "world": 0.0}
    return {**plain, "seconds": seconds}


def _run_0(plain: dict[str, Any]) -> dict[str, Any]:
    """The summary stood in the record, and a graph that failed left half a decision."""
    plain = {name: value for name, value in plain.items() if name != "summary"}
    nothing = as_plain(Decision(-1, 0.0, "", "", "", "", 0, 0, 0))
    decisions = [{**nothing, **decision} for decision in plain["decisions"]]
    return {**plain, "decisions": decisions, "predictions": []}


_CONVERSIONS_0 = {"paper": _paper_0, "arm": _arm_0, "opening": _timed, "run": _run_0}
"""Kind -> fields of version 1 from those of version 0; kinds that are not here did not change."""
