"""Closed against open doors: the paper's table of winner-take-all errors."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from flowbothd_common.markdown import markdown_table
from flowbothd_evaluation.paper.analysis.measure import Plain, mean, measure, seed_of, truth_of
from flowbothd_evaluation.paper.analysis.setting import Setting
from flowbothd_evaluation.paper.figures.style import (
    TRUTH_COLOUR,
    method_colour,
    method_label,
    save,
    tidy,
)
from flowbothd_model.metrics import FlowErrors
from flowbothd_policy.predictor import FlowPredictor

METRICS = {
    "cosine": "cosine\n(higher is better)",
    "mean_error": 'mean error: the paper\'s\n"RMSE" (lower is better)',
    "rmse": "root mean square error\n(lower is better)",
    "magnitude": "magnitude error\n(lower is better)",
}

PAPER: dict[str, dict[str, dict[str, float]]] = {
    "flowbothd": {
        "closed": {"cosine": 0.8046, "mean_error": 0.1833, "magnitude": 0.1047},
        "open": {"cosine": 0.9089, "mean_error": 0.1246, "magnitude": 0.0919},
    },
    "flowbot3d-ro": {
        "closed": {"cosine": 0.2033, "mean_error": 0.4426, "magnitude": 0.2468},
        "open": {"cosine": 0.7351, "mean_error": 0.2218, "magnitude": 0.1782},
    },
    "flowbot3d-md": {
        "closed": {"cosine": 0.3129, "mean_error": 0.4069, "magnitude": 0.2150},
        "open": {"cosine": 0.2720, "mean_error": 0.4617, "magnitude": 0.2215},
    },
}
"""The paper's table; what it calls RMSE is the mean error in its code."""

CLOSED = 0.1
"""Open ratio below which a door counts as closed."""

BEHIND = 0.1
"""How far the history lies behind, as a share of the range."""


def closed_and_open(
    settings: Sequence[Setting],
    predictors: Mapping[str, FlowPredictor],
    *,
    ratios: Sequence[float] = (0.0, 0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95),
    samples: int = 20,
    remembering: Collection[str] = ("flowbothd",),
    seed: int = 0,
) -> Plain:
    """Errors of the best of several samples, averaged over closed and over open doors.

    As published, open doors come with the history of a tenth of the range before, with its truth;
    methods in `remembering` are also measured on open doors without it.

    Args:
        settings: Doors.
        predictors: By method.
        ratios: Openings.
        samples: Of which the one with the least squared error over all points counts.
        remembering: Methods that use a history.
        seed: Of clouds and samples.
    """
    found: dict[tuple[str, str], list[FlowErrors]] = {}
    for number, setting in enumerate(settings):
        for ratio in ratios:
            seen = setting.see(ratio, seed_of(seed, number))
            if seen is None:
                continue
            state = "closed" if ratio < CLOSED else "open"
            # Other points than the current cloud's, as a second look has.
            before = setting.see(max(ratio - BEHIND, 0.0), seed_of(seed, number, 2))
            past = truth_of(before) if before is not None and state == "open" else None
            for name, predictor in predictors.items():
                key = seed_of(seed, number, round(1000 * ratio))
                _, errors = measure(predictor, seen, past, samples, key)
                found.setdefault((name, state), []).append(errors)
                if name in remembering and past is not None:
                    _, errors = measure(predictor, seen, None, samples, key)
                    found.setdefault((name, "open without history"), []).append(errors)
    return {
        "what": f"best of {samples} samples by squared error over all points; closed: open ratio "
        f"< {CLOSED}, no history; open: with the true history {BEHIND} of the range before; mean "
        "over clouds",
        "objects": [setting.item.name for setting in settings],
        "ratios": list(ratios),
        "samples": samples,
        "seed": seed,
        "rows": [_row(name, state, errors) for (name, state), errors in found.items()],
        "paper": PAPER,
    }


def _row(method: str, state: str, errors: Sequence[FlowErrors]) -> Plain:
    best = {key: mean(float(getattr(e, key)[e.winner]) for e in errors) for key in METRICS}
    every = mean(float(e.cosine.mean()) for e in errors)
    wrong = mean(e.wrong_share for e in errors)
    return {
        "method": method,
        "state": state,
        "clouds": len(errors),
        **best,
        "mean_cosine_of_all_samples": every,
        "samples_against_the_opening": wrong,
    }


def markdown_closed_and_open(data: Plain) -> str:
    """The table, the paper's numbers beside ours in brackets."""
    names = ("cosine", 'mean error ("RMSE")', "root mean square", "magnitude error")
    rows = []
    for row in sorted(data["rows"], key=lambda r: str(r["state"])):
        paper = PAPER.get(row["method"], {}).get(row["state"], {})
        cells = [
            f"{row[key]:.3f}" + (f" ({paper[key]:.3f})" if key in paper else "") for key in METRICS
        ]
        label = method_label(row["method"])
        rows.append((row["state"], label, row["clouds"], *cells))
    return markdown_table(("doors", "method", "clouds", *(f"{n} (paper)" for n in names)), rows)


def draw_closed_and_open(data: Plain, path: Path) -> None:
    """One panel a metric, bars by method for closed and open; marks where the paper stands."""
    methods = list(dict.fromkeys(row["method"] for row in data["rows"]))
    states = [
        state
        for state in ("closed", "open", "open without history")
        if any(row["state"] == state for row in data["rows"])
    ]
    figure, axes = plt.subplots(1, len(METRICS), figsize=(14, 4), layout="constrained")
    for axis, (metric, label) in zip(axes, METRICS.items(), strict=True):
        _bars(axis, data, metric, methods, states)
        axis.set_xticks(
            range(len(states)), [state.replace(" without", ",\nno") for state in states]
        )
        axis.set_title(label, fontsize=10)
        tidy(axis)
    handles, labels = axes[0].get_legend_handles_labels()
    kept = dict(zip(labels, handles, strict=True))
    figure.legend(
        list(kept.values()),
        list(kept),
        loc="outside lower center",
        ncols=len(kept),
        frameon=False,
        fontsize=9,
    )
    figure.suptitle(
        f"Doors, closed and open: the best of {data['samples']} predictions", fontsize=12
    )
    save(figure, path)


def _bars(
    axis: Any, data: Plain, metric: str, methods: Sequence[str], states: Sequence[str]
) -> None:
    width = 0.84 / len(methods)
    for place, state in enumerate(states):
        shown = [row for row in data["rows"] if row["state"] == state]
        shown.sort(key=lambda row: methods.index(row["method"]))
        for number, row in enumerate(shown):
            method = row["method"]
            at = place + (number - (len(shown) - 1) / 2) * width
            bars = axis.bar(
                at,
                row[metric],
                width * 0.92,
                color=method_colour(method),
                label=method_label(method),
            )
            anchor = PAPER.get(method, {}).get(state, {}).get(metric)
            if anchor is not None:
                ends = (at - 0.46 * width, at + 0.46 * width)
                axis.plot(
                    ends, (anchor, anchor), color=TRUTH_COLOUR, lw=4, label="the paper's number"
                )
            axis.bar_label(
                bars, fmt="%.2f", fontsize=8, label_type="center", color="white", zorder=9
            )
    values = np.array([row[metric] for row in data["rows"]])
    axis.set_ylim(min(0.0, 1.2 * float(values.min())), None)
    axis.axhline(0, color="0.3", lw=0.8)
