"""How often the policy takes hold anew: per step, and per trial."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from flowbothd_evaluation.paper.figures.style import (
    fullest,
    method_colour,
    row_label,
    row_style,
    rows_of,
    save,
    tidy,
)
from flowbothd_evaluation.records import PaperRecord

FEWEST = 5
"""Trials that must still be running for a share to be drawn: of fewer it says nothing."""

MOST_GRASPS = 8
"""Trials with more grasps share the last bar of the histogram."""


def switch_share(
    records: Sequence[PaperRecord], steps: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(steps,) share of pulls 1, 2, ... made from a new grasp, and (steps,) trials that made them.

    NaN where no trial made that pull.
    """
    share, count = np.full(steps, np.nan), np.zeros(steps, dtype=np.int64)
    for step in range(steps):
        flags = [r.per_step.grasp_switched for r in records]
        made = [bool(own[step]) for own in flags if len(own) > step]
        count[step] = len(made)
        if made:
            share[step] = np.mean(made)
    return share, count


def draw_grasp_switches(records: Sequence[PaperRecord], path: Path) -> None:
    """Share of the pulls of each step index that came from a switched grasp; below, how many.

    Every method with all its switches; without the switch of grasps there is nothing to count.
    """
    steps = max([len(r.per_step.grasp_switched) for r in records], default=1)
    steps = max(steps, 1)
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(8.4, 4.8), sharex=True, height_ratios=(3, 1), layout="constrained"
    )
    numbers = np.arange(1, steps + 1)
    for (method, switches), own in fullest(rows_of(records)).items():
        share, count = switch_share(own, steps)
        style = row_style(method, switches)
        shown = np.where(count >= min(FEWEST, len(own)), share, np.nan)
        top.plot(
            numbers, shown, marker="o", ms=3, lw=1.8, label=row_label(method, switches), **style
        )
        bottom.plot(numbers, count, lw=1.5, **style)
    top.set(
        ylabel="pulls from a\nswitched grasp",
        ylim=(-0.02, 1.02),
        title="Grasp switches per step",
    )
    top.yaxis.set_major_formatter(mpl.ticker.PercentFormatter(1.0))
    bottom.set(
        xlabel=f"time step (pull; shares of fewer than {FEWEST} trials are left out)",
        ylabel="trials still\nrunning",
        xlim=(0.5, steps + 0.5),
        ylim=(0, None),
    )
    bottom.xaxis.get_major_locator().set_params(integer=True)
    tidy(top)
    tidy(bottom)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False, handlelength=3)
    save(figure, path)


def grasp_shares(records: Sequence[PaperRecord]) -> NDArray[np.float64]:
    """(MOST_GRASPS + 1,) share of trials with 0, 1, ... grasps; the last entry: that many or more.

    All trials count, those without any contact too.
    """
    grasps = [min(record.grasps, MOST_GRASPS) for record in records]
    return np.bincount(grasps, minlength=MOST_GRASPS + 1) / max(len(grasps), 1)


def draw_grasp_counts(records: Sequence[PaperRecord], path: Path) -> None:
    """One small histogram a row of the tables: grasps per trial."""
    rows = rows_of(records)
    columns = min(3, max(len(rows), 1))
    lines = -(-max(len(rows), 1) // columns)
    figure, axes = plt.subplots(
        lines,
        columns,
        figsize=(max(3.1 * columns + 0.6, 5.0), 1.9 * lines + 0.9),
        sharex=True,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    names = [*(str(n) for n in range(MOST_GRASPS)), f"{MOST_GRASPS}+"]
    for axis in axes.flat:
        axis.set_visible(False)
    for axis, ((method, switches), own) in zip(axes.flat, rows.items(), strict=False):
        axis.set_visible(True)
        axis.bar(names, grasp_shares(own), color=method_colour(method))
        mean = np.mean([r.grasps for r in own])
        axis.set_title(f"{row_label(method, switches)}\n{len(own)} trials, mean {mean:.2f}", size=9)
        axis.yaxis.set_major_formatter(mpl.ticker.PercentFormatter(1.0))
        axis.tick_params(labelbottom=True)
        tidy(axis)
    figure.supxlabel("grasps in the trial, the first included", fontsize=10)
    figure.supylabel("share of trials", fontsize=10)
    figure.suptitle("How many grasps a trial takes", fontsize=12)
    save(figure, path)
