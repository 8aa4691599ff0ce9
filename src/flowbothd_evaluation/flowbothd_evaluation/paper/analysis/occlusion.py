"""Errors against the open ratio, past the opening at which the part is seen edge-on."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from flowbothd_common.types import Cloud, History
from flowbothd_evaluation.paper.analysis.measure import (
    AGREES,
    Plain,
    measure,
    rounded,
    seed_of,
    truth_of,
)
from flowbothd_evaluation.paper.analysis.picture import Portrait, label_of
from flowbothd_evaluation.paper.analysis.setting import Setting, most_occluded
from flowbothd_evaluation.paper.figures.style import (
    TRUTH_COLOUR,
    method_colour,
    method_label,
    save,
    tidy,
    uses_history,
)
from flowbothd_model.data.observation import Observation
from flowbothd_model.metrics import FlowErrors
from flowbothd_policy.predictor import FlowPredictor

METRICS = {
    "cosine": "cosine (1 = right direction)",
    "mean_error": 'mean error (the paper\'s "RMSE")',
    "rmse": "root mean square error",
}
HISTORIES = {
    "true": (", true history", "-"),
    "own": (", history from its own predictions", "--"),
    "none": (", never a history", ":"),
}
"""What a method is given as history -> words for it and a line style.

true: the cloud of the step before with its true flow, as in the published evaluation. own: that
cloud with the first sample that agreed with the truth within 30 degrees there, as a run would hold
it; where none did, the older history stays, as the history filter has it.
"""

STEP = 2
"""Openings between a history and what is asked: of 21 openings a tenth of the range."""

_ACTED = 8  # samples of which a policy takes the first that agrees with how the part has moved


def occlusion(
    settings: Sequence[Setting],
    predictors: Mapping[str, FlowPredictor],
    *,
    ratios: Sequence[float] = tuple(np.linspace(0, 1, 21)),
    samples: int = 8,
    remembering: Collection[str] = ("flowbothd",),
    seed: int = 0,
) -> Plain:
    """Errors of every predictor while a part is opened before a fixed camera.

    Args:
        settings: Objects; the camera is moved to where the part is seen edge-on at some opening.
        predictors: By method.
        ratios: Openings, ascending.
        samples: Per cloud; means and quartiles are over them.
        remembering: Methods that use a history; they are asked with each of HISTORIES.
        seed: Of clouds and samples.
    """
    objects = []
    for number, setting in enumerate(settings):
        turned = most_occluded(setting, list(ratios)[3::4], seed_of(seed, number))
        seen = [turned.see(ratio, seed_of(seed, number)) for ratio in ratios]
        curves = [
            {
                "method": name,
                "history": kind,
                **_curve(predictor, seen, kind, samples, seed_of(seed, number, 1)),
            }
            for name, predictor in predictors.items()
            for kind in (HISTORIES if name in remembering else ("none",))
        ]
        item = turned.item
        objects.append(
            {
                "object": item.name,
                "category": item.category,
                "title": label_of(item),
                "joint": item.joints[turned.joint].name,
                "azimuth_deg": turned.azimuth,
                "elevation_deg": turned.elevation,
                "points_on_part": [turned.on_part(s) if s is not None else 0 for s in seen],
                "curves": curves,
            }
        )
    return {
        "what": "errors over the points that move; mean and quartiles of the samples of one cloud "
        f"per opening; histories lie {STEP} openings back",
        "ratios": rounded(ratios),
        "samples": samples,
        "seed": seed,
        "objects": objects,
    }


def _answers(
    predictor: FlowPredictor,
    seen: Sequence[Observation | None],
    kind: str,
    samples: int,
    seed: int,
) -> Iterator[tuple[Cloud, FlowErrors] | None]:
    """Flows and errors at every opening; None where nothing could be seen."""
    held: list[History | None] = []
    for number, view in enumerate(seen):
        past = held[max(0, number - STEP)] if number else None
        if view is None:
            held.append(past)
            yield None
            continue
        flows, errors = measure(predictor, view, past, samples, seed_of(seed, number))
        agreeing = np.flatnonzero(errors.cosine.numpy()[:_ACTED] > AGREES)
        if kind == "true":
            held.append(truth_of(view))
        elif kind == "own" and len(agreeing):
            held.append(History(view.points, flows[agreeing[0]]))
        else:
            held.append(past)
        yield flows, errors


def _curve(
    predictor: FlowPredictor,
    seen: Sequence[Observation | None],
    kind: str,
    samples: int,
    seed: int,
) -> Plain:
    """Mean and quartiles of each metric at every opening; None where nothing could be seen."""
    rows: dict[str, list[list[float]]] = {name: [] for name in METRICS}
    for answer in _answers(predictor, seen, kind, samples, seed):
        for name, values in rows.items():
            if answer is None:
                values.append([np.nan] * 3)
                continue
            data = getattr(answer[1], name).numpy()
            values.append([float(data.mean()), *np.quantile(data, (0.25, 0.75)).tolist()])
    return {
        name: {
            key: rounded([row[i] for row in values])
            for i, key in enumerate(("mean", "lower", "upper"))
        }
        for name, values in rows.items()
    }


def hidden(entry: Mapping[str, Any]) -> np.ndarray:
    """(R,) bool: openings at which under half of the closed part's points are seen."""
    counts = np.array(entry["points_on_part"], dtype=float)
    return np.asarray(counts < max(counts[0], 1.0) / 2)


def draw_occlusion(data: Plain, path: Path) -> None:
    """One row an object, one column a metric; grey where the part is nearly edge-on."""
    ratios = np.array(data["ratios"], dtype=float)
    rows = len(data["objects"])
    figure, axes = plt.subplots(
        rows,
        len(METRICS),
        figsize=(4.1 * len(METRICS), 2.7 * rows + 0.9),
        squeeze=False,
        sharex=True,
        layout="constrained",
    )
    for line, entry in zip(axes, data["objects"], strict=True):
        for axis, (metric, label) in zip(line, METRICS.items(), strict=True):
            for curve in entry["curves"]:
                _line(axis, ratios, curve, metric)
            _shade(axis, ratios, hidden(entry))
            axis.set(ylabel=label, xlim=(0, 1))
            axis.set_ylim(*((-1.05, 1.05) if metric == "cosine" else (0, 1.3)))
            tidy(axis)
        line[0].set_title(
            f"{entry['title']}, camera azimuth {entry['azimuth_deg']:.0f}°",
            fontsize=10,
            loc="left",
        )
    for axis in axes[-1]:
        axis.set_xlabel("open ratio (0 = closed, 1 = open)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=9
    )
    figure.suptitle(
        "Predictions while the part is opened; grey: it is seen nearly edge-on (under half of the "
        "points that it has when closed)",
        fontsize=11,
    )
    save(figure, path)


def _line(axis: Any, ratios: np.ndarray, curve: Mapping[str, Any], metric: str) -> None:
    method, history = curve["method"], curve["history"]
    words, style = HISTORIES[history]
    # Of a method that knows no history there is nothing to say about it.
    alone = history == "none" and not uses_history(method)
    values = {key: np.array(part, dtype=float) for key, part in curve[metric].items()}
    label = method_label(method) + ("" if alone else words)
    colour = method_colour(method)
    axis.plot(ratios, values["mean"], color=colour, label=label, lw=2, ls="-" if alone else style)
    if alone or history == "true":
        axis.fill_between(ratios, values["lower"], values["upper"], color=colour, alpha=0.15, lw=0)


def _shade(axis: Any, ratios: np.ndarray, flags: np.ndarray) -> None:
    half = float(np.diff(ratios).min()) / 2 if len(ratios) > 1 else 0.05
    for ratio in ratios[flags]:
        axis.axvspan(ratio - half, ratio + half, color="0.88", lw=0, zorder=0)


def draw_occluded_flows(
    settings: Sequence[Setting],
    predictors: Mapping[str, FlowPredictor],
    data: Plain,
    path: Path,
    *,
    shown: Sequence[str] = ("flowbothd", "flowbot3d-md"),
) -> None:
    """Flows at the opening with the least of the part in sight: the truth, then each method.

    The median of several samples; FlowBotHD with the true history, as in the curves.
    """
    names = [name for name in shown if name in predictors]
    figure, axes = plt.subplots(
        len(settings),
        1 + len(names),
        figsize=(2.9 * (1 + len(names)), 2.8 * len(settings) + 0.6),
        squeeze=False,
        layout="constrained",
    )
    ratios, seed = data["ratios"], data["seed"]
    for number, (line, setting) in enumerate(zip(axes, settings, strict=True)):
        entry = data["objects"][number]
        turned = Setting(setting.item, setting.joint, entry["azimuth_deg"], entry["elevation_deg"])
        counts = entry["points_on_part"]
        # Past the first openings, so that there is something to remember.
        at = min(range(STEP + 1, len(ratios)), key=lambda i: (counts[i] == 0, counts[i]))
        seen = [turned.see(ratio, seed_of(seed, number)) for ratio in ratios[: at + 1]]
        last = seen[-1]
        if last is None:
            continue
        # From the other side than the camera, where the hidden part can be seen.
        side = -0.7 if turned.azimuth < 90 else 0.7
        portrait = Portrait(turned, (0.0, ratios[at]), side)
        title = f"{entry['title']}, open {ratios[at]:.2f}: truth"
        portrait.draw(line[0], ratios[at], last.points, last.flow, TRUTH_COLOUR, title)
        for axis, name in zip(line[1:], names, strict=True):
            known = ", true history" if uses_history(name) else ""
            flow, cosine = _typical(predictors[name], seen, seed_of(seed, number, 1))
            portrait.draw(
                axis,
                ratios[at],
                last.points,
                flow,
                method_colour(name),
                f"{method_label(name)}{known}: cosine {cosine:.2f}",
            )
    figure.suptitle("Flows where the part is hidden most from the camera", fontsize=11)
    save(figure, path)


def _typical(
    predictor: FlowPredictor, seen: Sequence[Observation | None], seed: int
) -> tuple[Cloud, float]:
    """The sample of median cosine at the last opening, and that cosine."""
    last, past = seen[-1], seen[-1 - STEP]
    if last is None:
        raise ValueError("nothing is seen at the last opening")
    history = truth_of(past) if past is not None else None
    flows, errors = measure(predictor, last, history, _ACTED, seed)
    middle = int(errors.cosine.argsort()[_ACTED // 2])
    return flows[middle], float(errors.cosine[middle])
