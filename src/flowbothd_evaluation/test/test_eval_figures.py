"""Figures made from records of trials: the numbers behind them, and that they can be drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from flowbothd_common.types import Outcome
from flowbothd_evaluation.paper.figures import draw_all, draw_policy_signals
from flowbothd_evaluation.paper.figures.grasps import MOST_GRASPS, grasp_shares, switch_share
from flowbothd_evaluation.paper.figures.policy_signals import telling_records
from flowbothd_evaluation.paper.figures.style import METHODS, method_colour, rows_of
from flowbothd_evaluation.paper.figures.success import step_of_success, success_over_steps
from flowbothd_evaluation.records import PaperRecord, PullSignals, Seconds


def trial(
    ratios: list[float],
    *,
    method: str = "flowbothd",
    switches: str = "SG+CC+HF",
    success: bool | None = None,
    grasps: int = 1,
    number: int = 0,
    mask: str = "truth",
    policy: str = "paper",
    seed: int = 0,
    **signals: tuple[Any, ...],
) -> PaperRecord:
    """A record as `flowbothd eval paper` writes it, with signals drawn from a seed."""
    rng = np.random.default_rng(seed)
    count = len(ratios)
    drawn = PullSignals(
        open_ratio=tuple(ratios),
        history_updated=tuple(bool(v) for v in rng.random(count) < 0.7),
        grasp_switched=tuple(bool(v) for v in rng.random(count) < 0.2),
        consistency_trials=tuple(int(v) for v in rng.integers(0, 4, count)),
        cosine=(None,) * count,
        rmse=(None,) * count,
        mean_error=(None,) * count,
    )
    opened = bool(ratios and ratios[-1] > 0.9)
    return PaperRecord(
        object="8994",
        category="Door",
        link="link_1",
        joint="joint_1",
        trial=number,
        method=method,
        switches=switches,
        target_mask=mask,
        policy=policy,
        weights="compact",
        weights_sha256="",
        max_steps=30,
        base_seed=0,
        seed=seed,
        outcome=Outcome.OPENED if opened else Outcome.GAVE_UP,
        reason="",
        success=opened if success is None else success,
        open_ratio=ratios[-1] if ratios else 0.0,
        normalized_distance=1 - (ratios[-1] if ratios else 0.0),
        steps=count,
        grasps=grasps,
        per_step=replace(drawn, **signals),
        seconds=Seconds(wall=1.0),
    )


ROWS = (
    *(("flowbothd", s) for s in ("SG+CC+HF", "SG+CC", "SG+HF", "SG", "")),
    ("flowbothd-nohistory", "SG+CC"),
    ("flowbothd-nodiffusion", "SG+HF"),
    ("flowbot3d-ro", ""),
    ("flowbot3d-ro", "SG"),
    ("flowbot3d-md", "SG"),
    ("oracle", "SG"),
    ("random", "SG"),
)


def run_of_records(trials: int = 20) -> list[PaperRecord]:
    """Trials of every row, of which some never touch anything."""
    rng = np.random.default_rng(1)
    records = []
    for row, (method, switches) in enumerate(ROWS):
        for number in range(trials):
            speed = rng.uniform(0.01, 0.3)
            ratios = np.minimum(np.arange(1, 31) * speed, 1.0)
            end = int(np.argmax(ratios > 0.9)) + 1 if ratios[-1] > 0.9 else 30
            shown = [] if rng.random() < 0.1 else [float(v) for v in ratios[:end]]
            records.append(
                trial(
                    shown,
                    method=method,
                    switches=switches,
                    grasps=int(rng.geometric(0.6)) if shown else 0,
                    number=number,
                    seed=100 * row + number,
                )
            )
    return records


def test_success_counts_trials_that_never_pulled():
    """The released code left them out of the denominator, which raised its success rate."""
    records = [trial([0.5, 0.95]), trial([]), trial([0.2, 0.4, 0.6]), trial([1.0])]
    rates = success_over_steps(records, 3)
    np.testing.assert_allclose(rates, [0.0, 0.25, 0.5, 0.5])


def test_success_never_falls_and_ends_at_the_recorded_success():
    records = [r for r in run_of_records() if r.method == "flowbothd"]
    rates = success_over_steps(records, 30)
    assert (np.diff(rates) >= 0).all()
    assert rates[-1] == pytest.approx(np.mean([r.success for r in records]))


def test_a_part_that_swung_open_and_shut_again_is_no_success():
    assert step_of_success(trial([0.95, 0.3], success=False)) is None
    assert step_of_success(trial([0.5, 0.95, 0.92])) == 2
    # Seen open only when the run ended, after the last pull was measured.
    assert step_of_success(trial([0.5, 0.89], success=True)) == 2


def test_switch_share_is_over_the_trials_that_made_the_pull():
    first = trial([0.1, 0.2, 0.3], grasp_switched=(False, True, False))
    second = trial([0.1], grasp_switched=(True,))
    share, count = switch_share([first, second, trial([])], 4)
    np.testing.assert_allclose(share, [0.5, 1.0, 0.0, np.nan])
    assert count.tolist() == [2, 1, 1, 0]


def test_grasp_shares_cover_all_trials():
    records = [trial([0.5], grasps=n) for n in (0, 1, 1, 3, MOST_GRASPS, 40)]
    shares = grasp_shares(records)
    assert shares.sum() == pytest.approx(1.0)
    assert shares[1] == pytest.approx(2 / 6)
    assert shares[MOST_GRASPS] == pytest.approx(2 / 6)


def test_rows_come_in_the_order_of_the_tables():
    records = [trial([], method=m, switches=s) for m, s in reversed(ROWS)]
    methods = [method for method, _ in rows_of(records)]
    assert methods == sorted(methods, key=list(METHODS).index)
    assert next(iter(rows_of(records))) == ("flowbothd", "SG+CC+HF")


def test_every_method_keeps_a_colour_of_its_own():
    colours = [method_colour(method) for method in METHODS]
    assert len(set(colours)) == len(colours)
    assert method_colour("own-model") == method_colour("own-model")
    assert method_colour("own-model") not in colours


def test_the_two_told_trials_are_a_smooth_and_a_laborious_success():
    easy = trial([0.2, 0.4, 0.6, 0.95], consistency_trials=(0, 0, 0, 0))
    hard = trial([0.0, 0.0, 0.3, 0.5, 0.95], grasps=4, consistency_trials=(0, 12, 3, 0, 0))
    other = trial([0.95], method="oracle", switches="SG")
    shown = telling_records([hard, other, easy, trial([])])
    assert [r is expected for r, expected in zip(shown, (easy, hard), strict=True)] == [True, True]
    assert telling_records([other]) == []


def test_all_figures_are_drawn_legible_and_small(tmp_path: Path):
    records = [
        *run_of_records(),
        *(trial([0.4, 0.95], mask="none", number=k) for k in range(3)),
        *(trial([0.3, 0.95], policy="robot", number=k) for k in range(3)),
    ]
    figures = draw_all(records, tmp_path / "figures")
    names = [path.name for _, path in figures]
    assert len(names) == len(set(names)) == 12
    for title, path in figures:
        assert title
        assert path.stat().st_size <= 200_000
        with Image.open(path) as image:
            assert image.width >= 500
            assert len(np.unique(np.asarray(image.convert("L")))) > 4, f"{path.name} is blank"


def test_trials_without_a_pull_are_drawn_too(tmp_path: Path):
    """A run in which nothing was touched must give a report, not an error."""
    assert len(draw_all([trial([])], tmp_path)) == 3
    assert draw_all([], tmp_path) == []


def test_links_that_the_truth_does_not_open_are_not_counted(tmp_path: Path):
    shut = replace(trial([]), outcome=Outcome.UNOPENABLE_WITH_GROUND_TRUTH)
    assert draw_all([shut], tmp_path) == []
    draw_all([trial([0.95]), shut], tmp_path / "with")
    draw_all([trial([0.95])], tmp_path / "without")
    for path in (tmp_path / "with").iterdir():
        assert path.read_bytes() == (tmp_path / "without" / path.name).read_bytes()


def test_missing_values_leave_a_gap(tmp_path: Path):
    record = trial([0.1, 0.2, 0.95], open_ratio=(0.1, None, 0.95))
    draw_policy_signals([record], tmp_path / "signals.png")
    assert step_of_success(record) == 3


def test_no_record_is_an_error_that_says_so(tmp_path: Path):
    with pytest.raises(ValueError, match="no record"):
        draw_policy_signals([], tmp_path / "signals.png")
