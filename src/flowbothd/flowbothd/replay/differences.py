"""Comparing what was recorded with what came out again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

KEPT = 20
"""Differences that are kept in full; the rest is counted."""


@dataclass(frozen=True)
class Difference:
    """One output that came out otherwise.

    Attributes:
        stamp: Of the output [s]: its header's, or that of the cloud behind it.
        what: Which output, for people.
        field: What of it differs.
        recorded: As in the recording.
        recomputed: As it came out again.
    """

    stamp: float
    what: str
    field: str
    recorded: str
    recomputed: str


@dataclass
class Comparison:
    """Outputs of one node, recorded and recomputed.

    Attributes:
        node: perception, inference or policy.
        compared: Outputs that were compared.
        equal: Those of them that were the same to the last bit.
        differences: The first ones, by stamp.
        left_out: Outputs that could not come out again, since their inputs were made before the
            recorder listened.
        remark: On what was left out.
        problems: Why something could not be compared.
    """

    node: str
    compared: int = 0
    equal: int = 0
    differences: list[Difference] = field(default_factory=list)
    left_out: int = 0
    remark: str = ""
    problems: list[str] = field(default_factory=list)

    @property
    def identical(self) -> bool:
        """True if something was compared and all of it is the same."""
        return self.compared > 0 and self.equal == self.compared and not self.problems

    @property
    def first(self) -> Difference | None:
        """The earliest difference."""
        return min(self.differences, key=lambda d: d.stamp) if self.differences else None

    def add(self, found: list[Difference]) -> None:
        """Take in one compared output with its differences, none if it is the same."""
        self.compared += 1
        self.equal += not found
        self.differences += found[: max(KEPT - len(self.differences), 0)]

    def text(self) -> str:
        """For people: figures, the first difference, problems."""
        lines = [f"{self.node}: {self.equal} of {self.compared} outputs identical"]
        first = self.first
        if first is not None:
            lines.append(
                f"  first difference at {first.stamp:.9f} s, {first.what}: {first.field} was "
                f"{first.recorded}, now {first.recomputed}"
            )
        others = [d for d in self.differences if d is not first]
        lines += [
            f"  {d.stamp:.9f} s, {d.what}: {d.field} was {d.recorded}, now {d.recomputed}"
            for d in others[:4]
        ]
        left = self.compared - self.equal
        if left > 5:
            lines.append(f"  ... {left} outputs differ in all")
        notes = [self.remark] if self.remark else []
        return "\n".join([*lines, *(f"  {note}" for note in [*notes, *self.problems])])


def compare_fields(
    stamp: float, what: str, recorded: Mapping[str, Any], recomputed: Mapping[str, Any]
) -> list[Difference]:
    """Differences between two flat descriptions of one output; exact."""
    return [
        Difference(stamp, what, name, str(value), str(recomputed.get(name)))
        for name, value in recorded.items()
        if recomputed.get(name) != value
    ]


def compare_arrays(
    stamp: float, what: str, recorded: NDArray[Any], recomputed: NDArray[Any]
) -> list[Difference]:
    """Differences between two arrays, summed up in one; exact, NaN equals NaN."""
    if recorded.shape != recomputed.shape:
        shapes = (str(recorded.shape), str(recomputed.shape))
        return [Difference(stamp, what, "shape", *shapes)]
    same = (recorded == recomputed) | (np.isnan(recorded) & np.isnan(recomputed))
    if same.all():
        return []
    # In double: the difference of two float32 may be larger than either.
    apart = np.abs(recorded.astype(float) - recomputed.astype(float))[~same]
    worst = float(np.nanmax(apart)) if np.isfinite(apart).any() else float("nan")
    text = f"{int((~same).sum())} of {same.size} values other, by up to {worst:.3g}"
    return [Difference(stamp, what, "values", "as recorded", text)]
