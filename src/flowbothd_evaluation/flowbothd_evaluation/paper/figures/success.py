"""Success rate over time step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from flowbothd_evaluation.paper.figures.style import (
    fullest,
    row_label,
    row_style,
    rows_of,
    save,
    tidy,
)
from flowbothd_evaluation.records import PaperRecord
from flowbothd_evaluation.run_record.record import OPEN


def step_of_success(record: PaperRecord) -> int | None:
    """The pull (1 = the first) after which the part counted as open; None if it never did.

    Trials without success never did, whatever a part swung to on the way.
    """
    if not record.success:
        return None
    ratios = record.per_step.open_ratio
    reached = [i + 1 for i, ratio in enumerate(ratios) if ratio is not None and ratio > OPEN]
    # A success that no pull shows was seen after the last one.
    return reached[0] if reached else max(len(ratios), 1)


def success_over_steps(records: Sequence[PaperRecord], steps: int) -> NDArray[np.float64]:
    """(steps + 1,) share of ALL trials that are open after 0, 1, ... pulls.

    Trials that never made a pull count as not open: the released code left them out.
    """
    reached = [step_of_success(record) for record in records]
    return np.array(
        [np.mean([r is not None and r <= step for r in reached]) for step in range(steps + 1)]
    )


def draw_success_over_steps(records: Sequence[PaperRecord], path: Path) -> None:
    """Share of all trials that are open after so many pulls, one line a row of the tables.

    Left every method with all its switches; right, if there are such rows, what fewer switches
    make of it.
    """
    steps = max([len(r.per_step.open_ratio) for r in records], default=1)
    rows = rows_of(records)
    full = fullest(rows)
    several = {row[0] for row in rows if row not in full}
    panels = [("Each method with all its switches", full)]
    if several:
        own = {row: trials for row, trials in rows.items() if row[0] in several}
        panels.append(("With fewer switches", own))
    figure, axes = plt.subplots(
        1,
        len(panels),
        figsize=(5.4 * len(panels), 4.9),
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for axis, (title, shown) in zip(axes[0], panels, strict=True):
        _panel(axis, title, shown, max(steps, 1))
    axes[0, 0].set_ylabel("trials opened (open ratio > 0.9)")
    figure.suptitle("Success rate over time step")
    save(figure, path)


def _panel(
    axis: Any,
    title: str,
    rows: Mapping[tuple[str, str], Sequence[PaperRecord]],
    steps: int,
) -> None:
    for (method, switches), own in rows.items():
        rates = success_over_steps(own, steps)
        label = f"{row_label(method, switches)}: {rates[-1]:.0%} of {len(own)}"
        axis.plot(range(steps + 1), rates, lw=2, label=label, **row_style(method, switches))
    axis.set(xlabel="time step (pulls made)", xlim=(0, steps), ylim=(0, 1.02))
    axis.set_title(title, fontsize=10)
    axis.yaxis.set_major_formatter(mpl.ticker.PercentFormatter(1.0))
    axis.xaxis.get_major_locator().set_params(integer=True)
    tidy(axis)
    axis.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.14),
        ncols=2,
        fontsize=8,
        frameon=False,
        handlelength=3.2,
    )
