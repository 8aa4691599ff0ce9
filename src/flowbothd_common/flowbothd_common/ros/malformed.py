"""Malformed copies of a good message, for tests that every node survives them."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

_NUMBERS = (float("nan"), float("inf"), float("-inf"), 1e300)
_HOUR = 3600


def malformations(good: Any) -> Iterator[tuple[str, Any]]:
    """Yield labelled copies of a message with one thing wrong in each.

    Numbers that are not finite or enormous, sequences that are empty, short, long or in another
    order, texts and frames of something else, stamps of zero, of the past and of the future.

    Args:
        good: A complete message; it stays as it is.
    """
    for path in _leaves(good, ()):
        kind = _get(good, path[:-1]).get_fields_and_field_types()[path[-1]]
        for what, value in _wrong(_get(good, path), path[-1], kind):
            bad = copy.deepcopy(good)
            setattr(_get(bad, path[:-1]), path[-1], value)
            yield f"{'.'.join(map(str, path))} {what}", bad


def _leaves(message: Any, path: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        here = (*path, name)
        if _is_stamp(value):
            yield here
        elif hasattr(value, "get_fields_and_field_types"):
            yield from _leaves(value, here)
        else:
            yield here
            if isinstance(value, list) and value and _is_message(value[0]):
                for index in {0, len(value) - 1}:
                    yield from _leaves(value[index], (*here, index))


def _is_message(value: Any) -> bool:
    return hasattr(value, "get_fields_and_field_types")


def _is_stamp(value: Any) -> bool:
    return _is_message(value) and {"sec", "nanosec"} == set(value.get_fields_and_field_types())


def _wrong(value: Any, name: str, kind: str) -> Iterator[tuple[str, Any]]:
    if _is_stamp(value):
        for what, sec in (("zero", 0), ("past", value.sec - _HOUR), ("future", value.sec + _HOUR)):
            yield what, type(value)(sec=max(sec, 0), nanosec=0 if what == "zero" else value.nanosec)
    elif isinstance(value, bool):
        return
    elif isinstance(value, float):
        yield from ((str(number), number) for number in _NUMBERS)
    elif isinstance(value, int):
        bits = int("".join(filter(str.isdigit, kind)) or 8)
        lowest, highest = (
            (0, 2**bits - 1) if kind[0] in "ub" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        )
        yield from ((str(number), number) for number in {lowest, 0, 1, highest} - {value})
    elif isinstance(value, str):
        yield "empty", ""
        yield "other", f"{name} of something else"
    elif hasattr(value, "__len__"):
        yield from _wrong_sequence(value, fixed=kind.endswith("]"))


def _wrong_sequence(value: Any, *, fixed: bool) -> Iterator[tuple[str, Any]]:
    if not len(value):
        return
    if not fixed:
        yield "empty", value[:0]
        yield "short", value[:-1]
        yield "long", [*value, value[-1]] if isinstance(value, list) else value + value[-1:]
    yield "reversed", value[::-1]
    if isinstance(value[0], float):
        for number in _NUMBERS:
            wrong = copy.copy(value)
            wrong[len(value) // 2] = number
            yield f"with {number}", wrong


def _get(message: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        message = message[key] if isinstance(key, int) else getattr(message, key)
    return message
