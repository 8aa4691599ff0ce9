"""What the next prediction makes of no, a true, a good and a bad history."""

from __future__ import annotations

from collections.abc import Sequence
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
from flowbothd_evaluation.paper.analysis.setting import Setting
from flowbothd_evaluation.paper.figures.style import TRUTH_COLOUR, save, tidy
from flowbothd_model.data.observation import Observation
from flowbothd_policy.predictor import FlowPredictor

KINDS = {
    "none": ("no history", "#999999"),
    "true": ("true history", TRUTH_COLOUR),
    "even": ("true direction,\neven lengths", "#f0e442"),
    "good": ("good prediction\n(under 30° off)", "#0072b2"),
    "bad": ("bad prediction\n(over 90° off)", "#d55e00"),
}
"""Kind -> its name in words and its colour.

Beside the paper's: a history whose part moves in the true mean direction, as long at the hinge as
far from it, as a drawer does. Predictions without history are often like that.
"""

BEHIND = 0.1
"""How far the history lies behind, as a share of the range."""

_STILL = 1e-3  # mean flow of a link below which it does not move

Case = tuple[Setting, float]
"""An object and its opening."""


def history_filter(
    cases: Sequence[Case],
    predictor: FlowPredictor,
    *,
    samples: int = 50,
    seed: int = 0,
) -> Plain:
    """Errors of the next prediction for each kind of history, on the same clouds.

    Good and bad histories are the predictor's own samples, without history, a tenth of the range
    before. A cloud for which it gave no good or no bad one is left out and listed.

    Args:
        cases: Objects and openings; the opening must be above 0.
        predictor: That takes histories.
        samples: Per cloud and kind; as many are drawn for the histories.
        seed: Of clouds and samples.
    """
    clouds, skipped = [], []
    for number, (setting, ratio) in enumerate(cases):
        name = label_of(setting.item)
        histories = histories_of(setting, ratio, predictor, samples, seed_of(seed, number))
        seen = setting.see(ratio, seed_of(seed, number, 3))
        missing = [kind for kind in KINDS if kind not in histories]
        if seen is None or missing:
            why = "nothing that moves is seen" if seen is None else f"no {missing} prediction"
            skipped.append({"object": name, "ratio": ratio, "why": why})
            continue
        kinds = {}
        for kind in KINDS:
            _, errors = measure(predictor, seen, histories[kind], samples, seed_of(seed, number, 4))
            kinds[kind] = {
                "cosine": rounded(errors.cosine),
                "mean_error": rounded(errors.mean_error),
                "rmse": rounded(errors.rmse),
            }
        clouds.append({"object": name, "ratio": ratio, "kinds": kinds})
    return {
        "what": f"{samples} samples of the next prediction for each kind of history on the same "
        f"clouds; histories lie {BEHIND} of the range behind; good and bad ones are the "
        "predictor's own first answers",
        "samples": samples,
        "seed": seed,
        "clouds": clouds,
        "skipped": skipped,
        "medians": {
            kind: {
                key: round(float(np.median(pooled(clouds, kind, key))), 4)
                for key in ("cosine", "mean_error", "rmse")
            }
            for kind in KINDS
            if clouds
        },
    }


def pooled(clouds: Sequence[Plain], kind: str, metric: str) -> np.ndarray:
    """(clouds * samples,) values of one kind of history."""
    return np.concatenate([np.array(c["kinds"][kind][metric], dtype=float) for c in clouds])


def histories_of(
    setting: Setting, ratio: float, predictor: FlowPredictor, samples: int, seed: int
) -> dict[str, History | None]:
    """The histories by kind; kinds that did not come up are missing."""
    before = setting.see(max(ratio - BEHIND, 0.0), seed)
    found: dict[str, History | None] = {"none": None}
    if before is None:
        return found
    found["true"] = truth_of(before)
    found["even"] = History(before.points, even_lengths(before))
    flows, errors = measure(predictor, before, None, samples, seed)
    cosine = errors.cosine.numpy()
    if cosine.max() > AGREES:
        found["good"] = History(before.points, flows[int(cosine.argmax())])
    if cosine.min() < 0:
        found["bad"] = History(before.points, flows[int(cosine.argmin())])
    return found


def even_lengths(seen: Observation) -> Cloud:
    """(N, 3) float32 flow: every moving link as a whole, in its true mean direction."""
    flow = np.zeros_like(seen.flow)
    for link in np.unique(seen.link):
        own = seen.link == link
        direction = seen.flow[own].mean(0)
        length = float(np.linalg.norm(direction))
        if length > _STILL:
            flow[own] = direction / length
    return flow


def draw_history_filter(
    data: Plain, case: Case | None, predictor: FlowPredictor, path: Path
) -> None:
    """Above, the kinds of history on one cloud; below, box plots of what came of them."""
    figure = plt.figure(figsize=(10.5, 7.4), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=(1, 1.15))
    upper, lower = parts
    if case is not None:
        setting, ratio = case
        histories = histories_of(setting, ratio, predictor, data["samples"], data["seed"])
        portrait = Portrait(setting, (0.0, ratio))
        axes = upper.subplots(1, 3)
        for axis, kind in zip(axes, ("true", "good", "bad"), strict=True):
            title, colour = KINDS[kind]
            history = histories.get(kind)
            axis.set_axis_off()
            if history is not None:
                portrait.draw(
                    axis,
                    max(ratio - BEHIND, 0.0),
                    history.points,
                    history.flow,
                    colour,
                    title.replace("\n", " "),
                )
    left, right = lower.subplots(1, 2)
    for axis, metric, label in (
        (left, "cosine", "cosine of the next prediction (higher is better)"),
        (right, "mean_error", 'mean error, the paper\'s "RMSE" (lower is better)'),
    ):
        boxes = axis.boxplot(
            [pooled(data["clouds"], kind, metric) for kind in KINDS],
            tick_labels=[words for words, _ in KINDS.values()],
            patch_artist=True,
            medianprops={"color": "black", "lw": 1.6},
            flierprops={"ms": 2.5, "alpha": 0.4},
        )
        for patch, (_, colour) in zip(boxes["boxes"], KINDS.values(), strict=True):
            patch.set_facecolor(colour)
        axis.set_ylabel(label, fontsize=9)
        axis.tick_params(axis="x", labelsize=7.5)
        tidy(axis)
    figure.suptitle(
        f"What the history does to the next prediction: {len(data['clouds'])} clouds, "
        f"{data['samples']} samples each",
        fontsize=12,
    )
    save(figure, path)
