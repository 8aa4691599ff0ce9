"""The policy-signal plot of the paper: what the policy noticed and did, step by step."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

from flowbothd_evaluation.records import PullSignals
from flowbothd_evaluation.run_record.record import OPEN, RunRecord


@dataclass(frozen=True)
class StepSignals:
    """Signals of one flow step.

    Attributes:
        open_ratio: After the step.
        history_updated: The step's prediction was remembered.
        grasp_switched: The step was made from a new grasp point, with the part already moved.
        regrasped: The step was made after a failed attempt.
        trials: Samples rejected before the one that was executed.
    """

    open_ratio: float
    history_updated: bool
    grasp_switched: bool
    regrasped: bool
    trials: int


def step_signals(record: RunRecord) -> list[StepSignals]:
    """Signals of every executed flow step, in order."""
    signals: list[StepSignals] = []
    switched, trials, grasps, previous_grasps = False, 0, 0, 0
    for decision in record.decisions:
        switched |= decision.grasp_switched
        trials = max(trials, decision.trials)
        grasps = decision.grasps
        if decision.step > len(signals):
            signals.append(
                StepSignals(
                    record.open_ratio_at(decision.time),
                    decision.history_updated,
                    switched,
                    bool(signals) and grasps > previous_grasps and not switched,
                    trials,
                )
            )
            switched, trials, previous_grasps = False, 0, grasps
    return signals


def pull_signals(record: RunRecord) -> PullSignals:
    """Return the same by signal, as records of trials keep them."""
    signals = step_signals(record)
    return PullSignals(
        open_ratio=tuple(s.open_ratio for s in signals),
        history_updated=tuple(s.history_updated for s in signals),
        grasp_switched=tuple(s.grasp_switched for s in signals),
        consistency_trials=tuple(s.trials for s in signals),
    )


def plot_signals(record: RunRecord, path: Path) -> None:
    """Write the plot: open ratio, history updates, grasp switches, consistency trials per step."""
    signals = step_signals(record)
    steps = list(range(1, len(signals) + 1))
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(7, 4.6), sharex=True, height_ratios=(3, 1), layout="constrained"
    )
    top.axhline(OPEN, color="0.7", lw=1, ls="--", label="counts as open (0.9)")
    top.plot(steps, [s.open_ratio for s in signals], "-", color="#1b5e8c", lw=2, label="open ratio")
    rows = (
        ("history updated", [s.history_updated for s in signals], "o", "#2e8b57"),
        ("grasp switched", [s.grasp_switched for s in signals], "D", "#c0392b"),
        ("contact made again", [s.regrasped for s in signals], "s", "#e08e0b"),
    )
    for label, flags, marker, colour in rows:
        chosen = [(n, s.open_ratio) for n, s, on in zip(steps, signals, flags, strict=True) if on]
        top.plot(
            *zip(*chosen, strict=True) if chosen else ([], []), marker, color=colour, label=label
        )
    top.set(ylim=(-0.05, 1.1), ylabel="open ratio")
    top.legend(loc="upper left", fontsize=8, frameon=False)
    top.set_title(
        f"{record.object} {record.mode}: {record.outcome}, seed {record.seed}", fontsize=10
    )
    bottom.bar(steps, [s.trials for s in signals], color="#7d6ba0")
    bottom.set(xlabel="flow step", ylabel="rejected\nsamples")
    bottom.yaxis.get_major_locator().set_params(integer=True)
    bottom.xaxis.get_major_locator().set_params(integer=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
