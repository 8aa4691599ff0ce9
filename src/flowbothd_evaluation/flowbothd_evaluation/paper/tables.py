"""From records to the numbers of the paper's tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.stats import binomtest

from flowbothd_common.types import Array, Outcome
from flowbothd_evaluation.paper.methods import METHODS
from flowbothd_evaluation.paper.suites import PAPER_ROWS
from flowbothd_evaluation.records import PaperRecord

RowKey = tuple[str, str, str, str]
"""Method, switches, policy, target mask."""

_DROPPED = (Outcome.NO_CONTACT, Outcome.NOT_VISIBLE)
"""What the released code leaves out of numerator and denominator."""

_RESAMPLINGS = 2000


@dataclass(frozen=True)
class Interval:
    """A mean and its 95 % interval."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class RowNumbers:
    """One row of both tables.

    Attributes:
        key: Which row.
        records: That count: openable with the truth, errors among them.
        unopenable: Records that the ground-truth filter took out.
        success: Rate over samples; the interval is Wilson's, as if trials were independent.
        success_by_category: Mean over categories; interval by drawing objects and trials anew.
        distance: Normalised distance over samples, 0 = open; interval likewise.
        distance_by_category: Mean over categories; interval likewise.
        categories: Success rate, distance and count by category.
        released: Success rate over samples as the released code counts it.
        outcomes: How often each outcome.
        steps: Mean number of pulls.
        grasps: Mean number of contacts.
        cosine: Mean over pulls, of the sample that was acted upon.
        mean_error: Mean point error of it (the reference's "rmse").
        rmse: Root mean square error of it.
        seconds: Median wall time of a trial.
    """

    key: RowKey
    records: tuple[PaperRecord, ...]
    unopenable: int
    success: Interval
    success_by_category: Interval
    distance: Interval
    distance_by_category: Interval
    categories: dict[str, tuple[float, float, int]]
    released: float
    outcomes: dict[str, int]
    steps: float
    grasps: float
    cosine: float
    mean_error: float
    rmse: float
    seconds: float

    @property
    def title(self) -> str:
        """Return the row's title with the network behind it."""
        return row_title(self.key, self.records[0].weights if self.records else "")


def row_key(record: PaperRecord) -> RowKey:
    """The row that a record belongs to."""
    return record.method, record.switches, record.policy, record.target_mask


def row_title(key: RowKey, weights: str = "") -> str:
    """Return the method as in the tables.

    Args:
        key: Which row.
        weights: Name or path of the row's weights; empty = the method's own.
    """
    name, _, policy, _ = key
    title = METHODS[name].titled(weights) if name in METHODS else name
    return f"{title}, robot's policy" if policy == "robot" else title


def rows_of(records: Sequence[PaperRecord]) -> list[RowNumbers]:
    """Numbers of every row that has records: the paper's rows first, in its order."""
    grouped: dict[RowKey, list[PaperRecord]] = {}
    for record in records:
        grouped.setdefault(row_key(record), []).append(record)
    order = [(row.method, "+".join(row.switches)) for row in PAPER_ROWS]

    def rank(key: RowKey) -> tuple[Any, ...]:
        known = order.index(key[:2]) if key[:2] in order else len(order)
        limits = key[0] in ("oracle", "random")
        return key[3] != "truth", limits, key[2] != "paper", known, key

    return [numbers(key, grouped[key]) for key in sorted(grouped, key=rank)]


def numbers(key: RowKey, records: Sequence[PaperRecord]) -> RowNumbers:
    """One row."""
    shut = Outcome.UNOPENABLE_WITH_GROUND_TRUTH
    kept = [r for r in records if r.outcome != shut]
    opened = np.array([r.success for r in kept], dtype=float)
    distance = np.array([r.normalized_distance for r in kept], dtype=float)
    category = np.array([r.category for r in kept])
    objects = np.array([r.object for r in kept])
    counted = [r for r in kept if r.outcome not in _DROPPED]
    return RowNumbers(
        key,
        tuple(kept),
        len(records) - len(kept),
        wilson(int(opened.sum()), len(kept)),
        _redrawn(opened, objects, category),
        _redrawn(distance, objects, None),
        _redrawn(distance, objects, category),
        {
            str(name): (
                float(opened[category == name].mean()),
                float(distance[category == name].mean()),
                int((category == name).sum()),
            )
            for name in np.unique(category)
        },
        _mean([r.success for r in counted]),
        dict(Counter(r.outcome.value for r in records)),
        _mean([r.steps for r in kept]),
        _mean([r.grasps for r in kept]),
        _mean(_measured(r.per_step.cosine for r in kept)),
        _mean(_measured(r.per_step.mean_error for r in kept)),
        _mean(_measured(r.per_step.rmse for r in kept)),
        float(np.median([r.seconds.wall for r in kept])) if kept else float("nan"),
    )


def wilson(successes: int, total: int) -> Interval:
    """A rate with Wilson's 95 % interval; NaN for no trials."""
    if not total:
        return Interval(float("nan"), float("nan"), float("nan"))
    found = binomtest(successes, total).proportion_ci(method="wilson")
    return Interval(successes / total, float(found.low), float(found.high))


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def _measured(columns: Iterable[Sequence[float | None]]) -> list[float]:
    return [value for column in columns for value in column if value is not None]


def _redrawn(
    values: Array, objects: NDArray[Any], categories: NDArray[Any] | None, seed: int = 0
) -> Interval:
    """Mean (over categories, where given) with its interval by drawing objects and trials anew.

    Trials of one object are much alike: to draw single trials would make the interval too narrow.
    Where a category has one object, its trials alone can be drawn, and the interval is too narrow.
    """
    if not len(values):
        return Interval(float("nan"), float("nan"), float("nan"))
    rng = np.random.default_rng(seed)
    strata = ["all"] * len(values) if categories is None else [str(c) for c in categories]
    means, draws = [], []
    for stratum in sorted(set(strata)):
        mine = np.array([s == stratum for s in strata])
        means.append(values[mine].mean())
        groups = [values[mine & (objects == name)] for name in np.unique(objects[mine])]
        counts = np.array([len(group) for group in groups])
        sums = np.stack(
            [g[rng.integers(len(g), size=(_RESAMPLINGS, len(g)))].sum(1) for g in groups], axis=1
        )
        drawn = rng.integers(len(groups), size=sums.shape)
        draws.append(np.take_along_axis(sums, drawn, axis=1).sum(1) / counts[drawn].sum(1))
    low, high = np.percentile(np.mean(draws, axis=0), [2.5, 97.5])
    return Interval(float(np.mean(means)), float(low), float(high))


@dataclass(frozen=True)
class Comparison:
    """Two rows on the same trials.

    Attributes:
        other: The row compared with.
        other_title: Its title.
        trials: That both have.
        difference: Success rate of the first less that of the other; interval by redrawn objects.
        only_first: Trials that the first alone opened.
        only_other: Trials that the other alone opened, as "object link".
    """

    other: RowKey
    other_title: str
    trials: int
    difference: Interval
    only_first: int
    only_other: dict[str, int]


def compare(first: RowNumbers, other: RowNumbers) -> Comparison:
    """Paired by object, link and trial, which have the same draws in both."""
    others = {_pairing(r): r for r in other.records}
    pairs = [(r, others[_pairing(r)]) for r in first.records if _pairing(r) in others]
    gain = np.array([float(a.success) - float(b.success) for a, b in pairs])
    objects = np.array([a.object for a, _ in pairs])
    lost = Counter(f"{a.object} {b.link}" for (a, b), g in zip(pairs, gain, strict=True) if g < 0)
    return Comparison(
        other.key,
        other.title,
        len(pairs),
        _redrawn(gain, objects, None),
        int((gain > 0).sum()),
        dict(lost),
    )


def _pairing(record: PaperRecord) -> tuple[str, str, int]:
    return record.object, record.target, record.trial


@cache
def _paper() -> dict[str, Any]:
    text = files("flowbothd_evaluation.paper").joinpath("paper_numbers.yaml").read_text()
    found: dict[str, Any] = yaml.safe_load(text)
    return found


def paper_row(key: RowKey, table: str) -> dict[str, float]:
    """The paper's numbers of a row by category; empty if it has no such row.

    Args:
        key: Which row.
        table: success or distance.
    """
    name, switches, policy, mask = key
    if policy != "paper" or mask != "truth":
        return {}
    for row in _paper()[table]:
        if (row["method"], row["switches"]) == (name, switches):
            return dict(zip(_paper()["categories"], row["values"], strict=True))
    return {}
