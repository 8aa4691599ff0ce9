"""The policy-signal plot of one trial, from its record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.patches import Patch

from flowbothd_evaluation.paper.figures.style import row_label, save, tidy
from flowbothd_evaluation.records import PaperRecord, PullSignals

_LINE, _HISTORY, _GRASP, _BARS = "#0072b2", "#d55e00", "#e69f00", "#c9c9c9"


def telling_records(records: Sequence[PaperRecord]) -> list[PaperRecord]:
    """A smooth success and a laborious one of the full method, as in the paper; fewer if none.

    The smooth one has the fewest rejected samples and grasps and at least four pulls if any has;
    the laborious one the most of both.
    """
    full = [r for r in records if r.method == "flowbothd" and r.per_step.open_ratio]
    most = max((len(r.switches) for r in full), default=0)
    opened = [r for r in full if r.success and len(r.switches) == most] or full
    if not opened:
        return []

    def trouble(record: PaperRecord) -> tuple[int, int]:
        return sum(record.per_step.consistency_trials) + 3 * record.grasps, record.steps

    long_ones = [r for r in opened if len(r.per_step.open_ratio) >= 4] or opened
    smooth, laborious = min(long_ones, key=trouble), max(opened, key=trouble)
    return [smooth] if smooth is laborious else [smooth, laborious]


def draw_policy_signals(records: Sequence[PaperRecord], path: Path) -> None:
    """One panel a record: open ratio, history updates, switched grasps, rejected samples per step.

    Args:
        records: The trials to show, best one or two.
        path: Of the PNG.

    Raises:
        ValueError: no records.
    """
    if not records:
        raise ValueError("no record to draw signals of")
    figure, axes = plt.subplots(
        len(records),
        1,
        figsize=(8, 3.3 * len(records) + 0.3),
        squeeze=False,
        layout="constrained",
    )
    for axis, record in zip(axes[:, 0], records, strict=True):
        shown = signal_panel(axis, record.per_step)
        axis.set_title(
            f"{record.category} {record.object} {record.joint}, trial {record.trial}: "
            f"{record.outcome} ({row_label(record.method, record.switches)})",
            fontsize=10,
        )
    figure.legend(handles=shown, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    save(figure, path)


def signal_panel(axis: Any, signals: PullSignals) -> list[Any]:
    """Signals of one trial over its steps, the `per_step` of its record, on an axis of matplotlib.

    The bars of rejected samples get an axis of their own on the right.

    Returns:
        What a legend is to show.
    """
    ratios = [float("nan") if r is None else float(r) for r in signals.open_ratio]
    steps = list(range(1, len(ratios) + 1))
    right = axis.twinx()
    right.bar(steps, signals.consistency_trials, width=0.6, color=_BARS, zorder=1)
    right.set_ylabel("samples rejected", color="0.4")
    right.set_ylim(0, max(4, 1.25 * max(signals.consistency_trials, default=0)))
    right.yaxis.get_major_locator().set_params(integer=True)
    right.spines["top"].set_visible(False)
    # The line lies over the bars although their axis is the later one.
    axis.set_zorder(right.get_zorder() + 1)
    axis.patch.set_visible(False)
    axis.axhline(0.9, color="0.6", lw=1, ls="--")
    axis.plot(steps, ratios, "-", color=_LINE, lw=2, label="open ratio")
    # A switch is marked above the line, so that it hides no update of the same step.
    for flags, marker, colour, label, lift in (
        (signals.history_updated, "o", _HISTORY, "history updated", 0.0),
        (signals.grasp_switched, "v", _GRASP, "grasp switched", 0.1),
    ):
        chosen = [(n, r + lift) for n, r, on in zip(steps, ratios, flags, strict=True) if on]
        where: Any = zip(*chosen, strict=True) if chosen else ([], [])
        axis.plot(*where, marker, color=colour, label=label, ms=8, mec="black", mew=0.6)
    axis.set(ylim=(-0.05, 1.15), ylabel="open ratio", xlim=(0.4, len(steps) + 0.6))
    axis.set_xlabel("time step (pull)")
    axis.xaxis.get_major_locator().set_params(integer=True)
    tidy(axis)
    lines, _ = axis.get_legend_handles_labels()
    return [*lines, Patch(color=_BARS, label="samples rejected (right axis)")]
