"""Figures drawn from records of trials alone: no network, no simulator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from flowbothd_common.types import Outcome
from flowbothd_evaluation.paper.figures.grasps import draw_grasp_counts, draw_grasp_switches
from flowbothd_evaluation.paper.figures.policy_signals import draw_policy_signals, telling_records
from flowbothd_evaluation.paper.figures.success import draw_success_over_steps
from flowbothd_evaluation.records import PaperRecord

_MASKS = {
    "truth": "only points of the target link may be grasped",
    "none": "the whole cloud may be grasped",
}

_POLICIES = {"paper": "the paper's policy", "robot": "the robot's policy"}

_NOT_COUNTED = Outcome.UNOPENABLE_WITH_GROUND_TRUTH
"""Outcome of links that the ground truth does not open either; tables leave them out, too."""

_PLOTS: tuple[tuple[str, str, Callable[[Sequence[PaperRecord], Path], None]], ...] = (
    ("success_over_steps", "Success rate over time step", draw_success_over_steps),
    ("grasp_switches", "Grasp switches per step", draw_grasp_switches),
    ("grasp_counts", "Grasps per trial", draw_grasp_counts),
)


def draw_all(records: Sequence[PaperRecord], out: Path) -> list[tuple[str, Path]]:
    """Draw every figure that records alone give.

    One set for each convention of the target mask and each policy, since these are different
    experiments. Records of links that the ground truth does not open are left out.

    Args:
        records: Of trials, as `flowbothd eval paper` writes them.
        out: Folder of the PNGs; made if it is missing.

    Returns:
        (title, file) in the order of a report; empty without records.
    """
    sets: dict[tuple[str, str], list[PaperRecord]] = {}
    for record in records:
        if record.outcome != _NOT_COUNTED:
            sets.setdefault((record.target_mask, record.policy), []).append(record)
    figures: list[tuple[str, Path]] = []
    # The released code's mask and the paper's policy come first.
    for mask, policy in sorted(sets, key=lambda key: (key[0] != "truth", key[1] != "paper", key)):
        figures += _one_set(sets[mask, policy], mask, policy, out)
    return figures


def _one_set(
    records: Sequence[PaperRecord], mask: str, policy: str, out: Path
) -> list[tuple[str, Path]]:
    """The figures of trials that were made alike."""
    note = f"{_POLICIES.get(policy, policy)}; {_MASKS.get(mask, mask)}"
    figures = []
    for name, title, draw in _PLOTS:
        path = out / f"{name}_{mask}_{policy}.png"
        draw(records, path)
        figures.append((f"{title} ({note})", path))
    shown = telling_records(records)
    if shown:
        path = out / f"policy_signals_{mask}_{policy}.png"
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
