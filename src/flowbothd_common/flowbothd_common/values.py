"""Checks on numbers that come from outside: finite, complete, within bounds.

A comparison with NaN is false, so a limit written ``value > limit`` lets NaN pass. Everything here,
and every limit of the cores, is written so that NaN fails.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from flowbothd_common.errors import InvalidMessageError
from flowbothd_common.types import Array


def finite(name: str, values: Iterable[float], size: int | None = None) -> Array:
    """Return `values` as a float64 vector.

    Args:
        name: Subject of the message, such as "positions".
        values: Numbers, in any sequence.
        size: Required number of them; None = any.

    Raises:
        InvalidMessageError: another number of values, or one that is not finite.
    """
    try:
        array = np.array(values, dtype=float).reshape(-1)
    except (TypeError, ValueError) as error:
        raise InvalidMessageError(f"{name} are not numbers: {error}") from error
    if size is not None and len(array) != size:
        raise InvalidMessageError(f"{name} are incomplete", got=len(array), allowed=size)
    bad = ~np.isfinite(array)
    if bad.any():
        raise InvalidMessageError(
            f"{name} are not finite",
            got=f"{array[bad][0]} at index {int(np.argmax(bad))} of {len(array)}",
        )
    return array


def bounded(name: str, value: float, low: float, high: float, unit: str = "") -> float:
    """Return `value` if ``low <= value <= high``.

    Raises:
        InvalidMessageError: it is not, or is NaN.
    """
    if not low <= value <= high:
        raise InvalidMessageError(name, got=value, allowed=f"{low:g} .. {high:g} {unit}".strip())
    return float(value)
