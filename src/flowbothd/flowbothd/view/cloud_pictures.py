"""Pictures of what the policy saw and chose, step by step, from clouds alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from flowbothd_evaluation.run_record.record import PredictionSample, RunRecord

MOST = 8
"""Moments that are drawn."""

_ARROWS = 120
_LENGTH = 0.1
"""Length of the arrow of the largest flow [m]."""


def choices(record: RunRecord) -> list[tuple[dict[str, Any], PredictionSample]]:
    """Decisions that act upon a prediction, each with it, in order."""
    found = []
    seen: set[tuple[float, int]] = set()
    for decision in record.decisions:
        sample, stamp = int(decision["chosen_sample"]), float(decision["prediction_stamp"])
        key = (stamp, sample)
        if sample < 0 or key in seen:
            continue
        # Several predictions are made for one cloud where samples are rejected: the last one won.
        fitting = [p for p in record.predictions if abs(p.stamp - stamp) < 1e-6]
        if fitting and sample < len(fitting[-1].flows):
            seen.add(key)
            found.append((decision, fitting[-1]))
    return found


def draw_choices(record: RunRecord, path: Path) -> bool:
    """Draw the object cloud, the chosen flow and the grasp of each step; False if there is none."""
    found = choices(record)
    if not found:
        return False
    if len(found) > MOST:
        found = [found[i] for i in np.linspace(0, len(found) - 1, MOST).astype(int)]
    columns = min(4, len(found))
    rows = -(-len(found) // columns)
    figure = plt.figure(figsize=(3.4 * columns, 3.5 * rows), layout="constrained")
    every = np.concatenate([p.points for _, p in found])
    low, high = every.min(axis=0), every.max(axis=0)
    for number, (decision, prediction) in enumerate(found, start=1):
        axes = figure.add_subplot(rows, columns, number, projection="3d")
        _draw(axes, decision, prediction)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        axes.set_box_aspect(np.maximum(high - low, 0.05))
    figure.savefig(path, dpi=90)
    plt.close(figure)
    return True


def _draw(axes: Any, decision: dict[str, Any], prediction: PredictionSample) -> None:
    points, flow = prediction.points, prediction.flows[int(decision["chosen_sample"])]
    chosen = np.unique(np.linspace(0, len(points) - 1, min(len(points), _ARROWS)).astype(int))
    axes.scatter(*points.T, s=3, color="0.45", linewidths=0)
    arrows = flow[chosen] * _LENGTH
    axes.quiver(*points[chosen].T, *arrows.T, color="#2e8b57", linewidth=0.9)
    grasp, pull = np.asarray(decision["grasp_point"]), np.asarray(decision["flow"])
    axes.scatter(*grasp[:, None], s=30, color="#c0392b")
    axes.quiver(*grasp[:, None], *(2 * _LENGTH * pull)[:, None], color="#c0392b", linewidth=2)
    axes.view_init(elev=20, azim=-75)
    axes.set_axis_off()
    title = f"{decision['time']:.1f} s, step {decision['step']}: {decision['decision']}"
    axes.set_title(title, fontsize=8)
