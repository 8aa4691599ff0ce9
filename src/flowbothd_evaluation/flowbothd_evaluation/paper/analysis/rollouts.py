"""Strips of recorded runs: the object at every decisive moment, with the flow that was acted on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from flowbothd_evaluation.paper.analysis.measure import Plain
from flowbothd_evaluation.paper.analysis.picture import draw_arrows, render, show, view_of
from flowbothd_evaluation.paper.figures.policy_signals import signal_panel
from flowbothd_evaluation.paper.figures.style import method_colour, save
from flowbothd_evaluation.rollout.floating import FLOATING_POLICY, floating_rollout
from flowbothd_evaluation.run_record.pictures import Moment, moments
from flowbothd_evaluation.run_record.record import RunRecord
from flowbothd_evaluation.run_record.signals import pull_signals
from flowbothd_policy.predictor import FlowPredictor
from sim_bridge.objects.from_urdf import standing_at
from sim_bridge.objects.model import ObjectModel
from sim_bridge.scene import Part


def rollouts(
    models: Sequence[ObjectModel], predictor: FlowPredictor, seeds: Sequence[int]
) -> tuple[Plain, list[tuple[ObjectModel, RunRecord]]]:
    """One run with the floating gripper for every object and seed, from closed.

    Args:
        models: Objects with their target joints.
        predictor: Samples the flows.
        seeds: Of the policy.
    """
    runs = []
    for model in models:
        for seed in seeds:
            params = replace(FLOATING_POLICY, seed=seed)
            runs.append((model, floating_rollout(model, params, predictor=predictor)))
    data = {
        "what": "runs of the whole policy with the floating gripper, from closed; target links "
        "alone may be grasped",
        "runs": [
            {"object": model.name, "joint": model.target_joint, **summary(record)}
            for model, record in runs
        ],
    }
    return data, runs


def summary(record: RunRecord) -> Plain:
    """What is kept of a run beside its picture."""
    kept = ("success", "open_ratio", "outcome", "reason", "steps", "grasps", "resamples", "seed")
    whole = record.summary()
    return {key: getattr(whole, key) for key in kept}


def telling_runs(
    runs: Sequence[tuple[ObjectModel, RunRecord]],
) -> list[tuple[ObjectModel, RunRecord]]:
    """A smooth run and a laborious one, successes if there are any, as in the paper."""

    def trouble(run: tuple[ObjectModel, RunRecord]) -> tuple[int, int]:
        whole = run[1].summary()
        return whole.resamples + 3 * whole.grasps, whole.steps

    pulled = [run for run in runs if run[1].summary().steps]
    opened = [run for run in pulled if run[1].summary().success] or pulled
    if not opened:
        return []
    smooth, laborious = min(opened, key=trouble), max(opened, key=trouble)
    return [smooth] if smooth is laborious else [smooth, laborious]


def draw_rollout(model: ObjectModel, record: RunRecord, path: Path, most: int = 10) -> None:
    """The strip of a run, five pictures a row, and under it the policy's signals.

    Args:
        model: The object of the run.
        record: With its predictions.
        path: Of the PNG.
        most: Pictures; moments between the first and the last are left out evenly.
    """
    shown = _captioned(record, most)
    columns = min(5, len(shown))
    rows = -(-len(shown) // columns)
    figure = plt.figure(figsize=(2.5 * columns, 2.65 * rows + 2.6), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=(2.65 * rows, 2.3))
    upper, lower = parts
    axes = upper.subplots(rows, columns, squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    stage = _Stage(model, [moment.state.joints for _, moment in shown])
    for axis, (caption, moment) in zip(axes.flat, shown, strict=False):
        stage.draw(axis, moment, caption)
    handles = signal_panel(lower.subplots(), pull_signals(record))
    lower.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    figure.suptitle(
        f"{model.name}, {model.target_joint}: {record.outcome} after "
        f"{record.summary().steps} pulls and {record.summary().grasps} grasps",
        fontsize=12,
    )
    save(figure, path)


def _captioned(record: RunRecord, most: int) -> list[tuple[str, Moment]]:
    """Pulls, failed grasps and the end, at most `most`, each with what happens in words."""
    found: list[tuple[str, Moment]] = []
    pulls = 0
    *during, end = moments(record, len(record.decisions) + 1)
    for moment in during:
        opened = f"open {abs(moment.state.open_ratio):.2f}"
        if moment.title.startswith("step"):
            pulls += 1
            found.append((f"pull {pulls}, {opened}", moment))
        elif moment.title.startswith("retreat"):
            found.append((f"lets go, {opened}", moment))
    chosen = np.unique(np.linspace(0, max(len(found) - 1, 0), most - 1).round().astype(int))
    last = (f"{record.outcome}, open {abs(end.state.open_ratio):.2f}", end)
    return [*(found[i] for i in chosen if found), last]


class _Stage:
    """The object where the floating gripper's world has it, before one view for all pictures."""

    def __init__(self, model: ObjectModel, positions: Sequence[Mapping[str, float]]) -> None:
        self._model = model
        self._pose = standing_at(model, 0.0, 0.0, 0.0)
        self._parts = [Part(name, link.meshes) for name, link in model.links.items()]
        bounds = np.array([model.bounds(at) for at in positions])
        low, high = bounds[:, 0].min(0), bounds[:, 1].max(0)
        shift = self._pose[:3, 3]
        self._view = view_of(low + shift, high + shift)
        self._arrow = 0.22 * float(np.linalg.norm(high - low))

    def draw(self, axis: Any, moment: Moment, caption: str) -> None:
        moved = self._model.displacements(moment.state.joints)
        poses = {name: self._pose @ matrix for name, matrix in moved.items()}
        picture = render(self._parts, poses, self._view)
        show(axis, picture, caption)
        if moment.prediction is None:
            return
        flow, points = moment.prediction.flows[moment.sample], moment.prediction.points
        draw_arrows(axis, self._view, points, flow, self._arrow, method_colour("flowbothd"))
        if moment.grasp is not None:
            self._mark(axis, moment, points, flow)

    def _mark(self, axis: Any, moment: Moment, points: Any, flow: Any) -> None:
        """The grasp point and where it is pulled to."""
        grasp = np.asarray(moment.grasp, dtype=float)
        pull = flow[int(np.argmin(np.linalg.norm(points - grasp, axis=1)))]
        tail, head = self._view.project(np.stack([grasp, grasp + 1.5 * self._arrow * pull]))
        axis.annotate("", head, tail, arrowprops={"arrowstyle": "-|>", "color": "#d55e00", "lw": 2})
        axis.plot(*tail, "o", color="#d55e00", mec="black", ms=6)
