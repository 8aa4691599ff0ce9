"""Metrics of a training run: CSV files, a plot, a progress bar."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from tqdm import tqdm


class RunLog:
    """Appends to `losses.csv` and `validation.csv`; rows after `step` are of a lost future.

    Args:
        folder: Of the run.
        step: Where the run begins or resumes.
        enabled: False in all but the first of several processes.
    """

    def __init__(self, folder: Path, step: int, enabled: bool = True) -> None:
        self._folder = folder
        self._enabled = enabled
        self._start = step
        if enabled:
            folder.mkdir(parents=True, exist_ok=True)
            for name in ("losses.csv", "validation.csv"):
                _cut(folder / name, step)

    def progress(self, total: int) -> tqdm:
        """The bar, from where the run began."""
        return tqdm(
            total=total,
            initial=self._start,
            unit="step",
            disable=not self._enabled,
            mininterval=5.0,
        )

    def loss(self, step: int, loss: float, rate: float, seconds: float) -> None:
        """One row per step; `seconds` since this process began."""
        self._append("losses.csv", {"step": step, "loss": loss, "rate": rate, "seconds": seconds})

    def validation(self, step: int, scores: Mapping[str, float]) -> None:
        """One row per validation, and a new plot."""
        self._append("validation.csv", {"step": step, **scores})
        if self._enabled:
            plot_run(self._folder)

    def _append(self, name: str, row: Mapping[str, float]) -> None:
        if not self._enabled:
            return
        path = self._folder / name
        new = not path.is_file() or path.stat().st_size == 0
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(row))
            if new:
                writer.writeheader()
            writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()})


def read_rows(path: Path) -> list[dict[str, float]]:
    """All rows of a CSV file of numbers; empty if there is none."""
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


def _cut(path: Path, step: int) -> None:
    """Drop rows after `step`."""
    if not path.is_file():
        return
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    kept = [line for line in lines[1:] if int(line.split(",", 1)[0]) <= step]
    path.write_text("".join(lines[:1] + kept), encoding="utf-8")


def plot_run(folder: Path) -> None:
    """Draw `curves.png`: the loss, smoothed, and the validation scores."""
    from matplotlib.figure import Figure

    losses, scores = read_rows(folder / "losses.csv"), read_rows(folder / "validation.csv")
    figure = Figure(figsize=(9, 3.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    window = max(1, len(losses) // 100)
    smooth = [
        sum(row["loss"] for row in losses[i : i + window]) / len(losses[i : i + window])
        for i in range(0, len(losses), window)
    ]
    left.plot([row["step"] for row in losses[::window]], smooth)
    left.set(xlabel="step", ylabel="loss", yscale="log")
    for name in [key for key in (scores[0] if scores else {}) if key != "step"]:
        right.plot([r["step"] for r in scores], [r[name] for r in scores], ".-", label=name)
    right.set(xlabel="step", ylim=(0, 1))
    if scores:
        right.legend(fontsize=7)
    figure.savefig(folder / "curves.png", dpi=110)
