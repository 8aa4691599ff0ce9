"""Objects that look the same whichever way they open, with several answers drawn on each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from flowbothd_common.types import Cloud
from flowbothd_evaluation.paper.analysis.measure import Plain, mean, measure, seed_of
from flowbothd_evaluation.paper.analysis.picture import Portrait, label_of
from flowbothd_evaluation.paper.analysis.setting import Setting, most_occluded
from flowbothd_evaluation.paper.figures.style import TRUTH_COLOUR, method_colour, save
from flowbothd_policy.predictor import FlowPredictor

SAME = 0.8
"""Agreement of whole fields from which two answers count as the same way to open."""

ANSWERS = 4
"""Ways to open that are drawn for each object."""


@dataclass(frozen=True)
class Showcase:
    """One ambiguous object.

    Attributes:
        title: What is ambiguous, in words.
        setting: The object.
        ratio: Its opening.
        edge_on: Look from where its part is seen edge-on at this opening.
    """

    title: str
    setting: Setting
    ratio: float = 0.0
    edge_on: bool = False

    def placed(self, seed: int) -> Setting:
        """The setting with its camera where this showcase needs it."""
        return most_occluded(self.setting, [self.ratio], seed) if self.edge_on else self.setting


@dataclass(frozen=True)
class Answers:
    """Different answers for one object.

    Attributes:
        flows: (A, N, 3), the commonest first.
        shares: Of the samples that agree with each.
        cosines: Mean cosine of each with the truth.
    """

    flows: Cloud
    shares: list[float]
    cosines: list[float]


def ways(flows: Cloud) -> list[tuple[int, float]]:
    """Groups of like fields among (S, N, 3) samples: (one of them, share), the commonest first.

    The sample with the most others like it stands for its group, and is taken out with it.
    """
    flat = flows.reshape(len(flows), -1).astype(float)
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    alike = flat @ flat.T > SAME
    np.fill_diagonal(alike, val=True)
    left = np.ones(len(flows), dtype=bool)
    groups = []
    while left.any():
        counts = (alike & left[None]).sum(1) * left
        chosen = int(counts.argmax())
        groups.append((chosen, float(counts[chosen]) / len(flows)))
        left &= ~alike[chosen]
    return groups


def showcases(
    cases: Sequence[Showcase], predictor: FlowPredictor, *, samples: int = 50, seed: int = 0
) -> tuple[Plain, list[tuple[Showcase, Setting, Answers]]]:
    """The different answers for each object, without history.

    Args:
        cases: Objects.
        predictor: Whom to ask.
        samples: Per object.
        seed: Of clouds and samples.
    """
    rows: list[Plain] = []
    found = []
    for number, case in enumerate(cases):
        setting = case.placed(seed_of(seed, number))
        seen = setting.see(case.ratio, seed_of(seed, number))
        if seen is None:
            rows.append({"title": case.title, "skipped": "nothing that moves is seen"})
            continue
        flows, errors = measure(predictor, seen, None, samples, seed_of(seed, number, 1))
        groups = ways(flows)
        chosen = [index for index, _ in groups[:ANSWERS]]
        cosines = [float(errors.cosine[index]) for index in chosen]
        answers = Answers(flows[chosen], [share for _, share in groups[:ANSWERS]], cosines)
        found.append((case, setting, answers))
        rows.append(
            {
                "title": case.title,
                "object": setting.item.name,
                "category": setting.item.category,
                "ratio": case.ratio,
                "azimuth_deg": setting.azimuth,
                "points_on_part": setting.on_part(seen),
                "different_answers": len(groups),
                "shares": [round(share, 4) for share in answers.shares],
                "cosines": [round(value, 4) for value in cosines],
                "mean_cosine": mean(errors.cosine),
                "best_mean_error": round(float(errors.mean_error.min()), 4),
            }
        )
    data = {
        "what": f"{samples} samples without history; answers that agree by more than {SAME} as "
        "whole fields are one",
        "samples": samples,
        "seed": seed,
        "objects": rows,
    }
    return data, found


def draw_showcases(
    found: Sequence[tuple[Showcase, Setting, Answers]], seed: int, path: Path
) -> None:
    """One row an object: the truth, then its commonest different answers with their shares."""
    figure = plt.figure(
        figsize=(2.1 * (ANSWERS + 1), 2.35 * len(found) + 0.5), layout="constrained"
    )
    rows = figure.subfigures(len(found), 1, squeeze=False)[:, 0]
    for number, (row, (case, setting, answers)) in enumerate(zip(rows, found, strict=True)):
        named = label_of(setting.item)
        row.suptitle(f"{case.title} ({named}, open {case.ratio:.1f})", size=9)
        axes = row.subplots(1, ANSWERS + 1)
        seen = setting.see(case.ratio, seed_of(seed, number))
        portrait = Portrait(setting, (0.0, case.ratio))
        for axis in axes:
            axis.set_axis_off()
        if seen is None:
            continue
        portrait.draw(axes[0], case.ratio, seen.points, seen.flow, TRUTH_COLOUR)
        axes[0].set_title("truth", size=8)
        for k, axis in enumerate(axes[1 : 1 + len(answers.flows)]):
            portrait.draw(
                axis, case.ratio, seen.points, answers.flows[k], method_colour("flowbothd")
            )
            axis.set_title(
                f"{answers.shares[k]:.0%} of samples, cosine {answers.cosines[k]:.2f}", size=8
            )
    figure.suptitle("Objects whose opening cannot be seen, and what is predicted", fontsize=12)
    save(figure, path)
