"""Whether predictions for closed objects hold both right answers and quite other ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from flowbothd_evaluation.paper.analysis.measure import Plain, mean, measure, seed_of
from flowbothd_evaluation.paper.analysis.setting import Setting
from flowbothd_evaluation.paper.figures.style import method_colour, method_label, save, tidy
from flowbothd_model.metrics import RIGHT_ERROR, WRONG_ERROR, FlowErrors
from flowbothd_policy.predictor import FlowPredictor

RIGHT_COSINE, WRONG_COSINE = 0.7, -0.7
"""The released code's rule: some sample's mean cosine above the first, some below the second."""


def multimodality(
    settings: Sequence[Setting],
    predictors: Mapping[str, FlowPredictor],
    *,
    samples: int = 50,
    seed: int = 0,
) -> Plain:
    """Both rules on every closed object, and how often each side of them occurs.

    Args:
        settings: Closed objects; one that shows nothing movable is listed as skipped.
        predictors: By method.
        samples: Per object.
        seed: Of clouds and samples.
    """
    rows, skipped = [], []
    for number, setting in enumerate(settings):
        seen = setting.see(0.0, seed_of(seed, number))
        if seen is None:
            skipped.append({"object": setting.item.name, "why": "nothing that moves is seen"})
            continue
        for name, predictor in predictors.items():
            _, errors = measure(predictor, seen, None, samples, seed_of(seed, number, 1))
            rows.append(
                {
                    "object": setting.item.name,
                    "category": setting.item.category,
                    "method": name,
                    **_row(errors),
                }
            )
    return {
        "what": f"closed objects, {samples} samples each without history, one cloud each; paper: "
        f"a mean error < {RIGHT_ERROR} and one > {WRONG_ERROR} occur; code: a mean cosine > "
        f"{RIGHT_COSINE} and one < {WRONG_COSINE} occur",
        "samples": samples,
        "seed": seed,
        "objects": rows,
        "skipped": skipped,
        "shares": shares(rows),
    }


def _row(errors: FlowErrors) -> Plain:
    return {
        "paper_rule": errors.multimodal,
        "code_rule": code_rule(errors),
        "right_by_error": mean((errors.mean_error < RIGHT_ERROR).float()),
        "wrong_by_error": mean((errors.mean_error > WRONG_ERROR).float()),
        "right_by_cosine": mean((errors.cosine > RIGHT_COSINE).float()),
        "wrong_by_cosine": mean((errors.cosine < WRONG_COSINE).float()),
        "least_mean_error": round(float(errors.mean_error.min()), 4),
        "largest_mean_error": round(float(errors.mean_error.max()), 4),
    }


def code_rule(errors: FlowErrors) -> bool:
    """The released code's rule on the samples of one cloud."""
    return bool((errors.cosine > RIGHT_COSINE).any() and (errors.cosine < WRONG_COSINE).any())


def shares(rows: Sequence[Mapping[str, Any]]) -> Plain:
    """By method and category, "all" included: objects, and the share that each rule counts."""
    result: Plain = {}
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        result[method] = {}
        for category in ["all", *sorted({row["category"] for row in own})]:
            chosen = [row for row in own if category in ("all", row["category"])]
            result[method][category] = {
                "objects": len(chosen),
                "paper_rule": mean(row["paper_rule"] for row in chosen),
                "code_rule": mean(row["code_rule"] for row in chosen),
                "right_by_cosine": mean(row["right_by_cosine"] for row in chosen),
                "wrong_by_cosine": mean(row["wrong_by_cosine"] for row in chosen),
            }
    return result


def draw_multimodality(data: Plain, path: Path, category: str = "Door") -> None:
    """Left the doors; beside them every category there is, by each of the two rules."""
    methods = list(data["shares"])
    categories = [name for name in data["shares"][methods[0]] if name != "all"]
    figure, (left, middle, right) = plt.subplots(
        1,
        3,
        figsize=(13, max(4.0, 1.6 + 0.27 * len(categories))),
        width_ratios=(1.35, 1, 1),
        layout="constrained",
    )
    _doors(left, data, methods, category if category in categories else "all")
    _categories(middle, data, methods, categories, "paper_rule")
    middle.set_ylabel("category (objects)")
    middle.set_title("all categories, paper's rule", fontsize=10)
    _categories(right, data, methods, categories, "code_rule")
    right.set_title("all categories, code's rule", fontsize=10)
    right.set_yticklabels([])
    figure.suptitle(
        f"Closed objects whose {data['samples']} predictions hold the right way and another",
        fontsize=12,
    )
    figure.legend(
        *right.get_legend_handles_labels(),
        loc="outside lower center",
        ncols=len(methods),
        frameon=False,
        fontsize=9,
    )
    save(figure, path)


def _doors(axis: Any, data: Plain, methods: Sequence[str], category: str) -> None:
    """Four bars a method: both rules, and the share of samples on each side of the code's."""
    groups = {
        "paper_rule": "by the\npaper's rule:\nerrors < 0.2\nand > 0.6",
        "code_rule": "by the\ncode's rule:\ncosines > 0.7\nand < -0.7",
        "right_by_cosine": "samples\nof cosine\n> 0.7",
        "wrong_by_cosine": "samples\nof cosine\n< -0.7",
    }
    width = 0.8 / len(methods)
    for number, method in enumerate(methods):
        values = [data["shares"][method][category][key] for key in groups]
        at = np.arange(len(groups)) + (number - (len(methods) - 1) / 2) * width
        bars = axis.bar(at, values, width * 0.92, color=method_colour(method))
        axis.bar_label(bars, [f"{v:.0%}" for v in values], fontsize=8)
    axis.set_xticks(range(len(groups)), list(groups.values()), fontsize=8)
    count = data["shares"][methods[0]][category]["objects"]
    axis.set_title(f"{category}: {count} closed objects", fontsize=10)
    _percent(axis.yaxis)
    axis.set(ylim=(0, 1.08), ylabel="share of objects | share of samples")
    axis.axvline(1.5, color="0.7", lw=1)
    tidy(axis)


def _categories(
    axis: Any, data: Plain, methods: Sequence[str], categories: Sequence[str], rule: str
) -> None:
    """Horizontal bars: the share of each category's objects that are multi-modal by a rule."""
    width = 0.8 / len(methods)
    for number, method in enumerate(methods):
        values = [data["shares"][method][name][rule] for name in categories]
        at = np.arange(len(categories)) + (number - (len(methods) - 1) / 2) * width
        axis.barh(at, values, width * 0.92, color=method_colour(method), label=method_label(method))
    counts = [data["shares"][methods[0]][name]["objects"] for name in categories]
    names = [f"{name} ({n})" for name, n in zip(categories, counts, strict=True)]
    axis.set_yticks(range(len(categories)), names, fontsize=8)
    axis.invert_yaxis()
    axis.set(xlim=(0, 1.02), xlabel="share of the objects (no bar: none)")
    _percent(axis.xaxis)
    tidy(axis)


def _percent(axis: Any) -> None:
    axis.set_major_formatter(mpl.ticker.PercentFormatter(1.0))
