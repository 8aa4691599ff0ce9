"""Figures drawn from records of trials alone: no network, no simulator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from flowbothd_bringup.evaluation.figures.grasps import draw_grasp_counts, draw_grasp_switches
from flowbothd_bringup.evaluation.figures.policy_signals import (
    draw_policy_signals,
    telling_records,
)
from flowbothd_bringup.evaluation.figures.success import draw_success_over_steps

_MASKS = {
    "truth": "only points of the target link may be grasped",
    "none": "the whole cloud may be grasped",
}

Draw = Callable[[Sequence[Mapping[str, Any]], Path], None]


def draw_all(records: Sequence[Mapping[str, Any]], out: Path) -> list[tuple[str, Path]]:
    """Draw every figure that records alone give, one set for each convention of the target mask.

    Args:
        records: Of trials, as `flowbothd eval` writes them.
        out: Folder of the PNGs; made if it is missing.

    Returns:
        (title, file) in the order of a report; empty without records.
    """
    figures: list[tuple[str, Path]] = []
    plots: tuple[tuple[str, str, Draw], ...] = (
        ("success_over_steps", "Success rate over time step", draw_success_over_steps),
        ("grasp_switches", "Grasp switches per step", draw_grasp_switches),
        ("grasp_counts", "Grasps per trial", draw_grasp_counts),
    )
    for mask in sorted({str(r["target_mask"]) for r in records}, reverse=True):
        own = [r for r in records if str(r["target_mask"]) == mask]
        note = _MASKS.get(mask, mask)
        for name, title, draw in plots:
            path = out / f"{name}_{mask}.png"
            draw(own, path)
            figures.append((f"{title} ({note})", path))
        shown = telling_records(own)
        if shown:
            path = out / f"policy_signals_{mask}.png"
            draw_policy_signals(shown, path)
            figures.append((f"Policy signals of single trials ({note})", path))
    return figures


__all__ = [
    "draw_all",
    "draw_grasp_counts",
    "draw_grasp_switches",
    "draw_policy_signals",
    "draw_success_over_steps",
]
