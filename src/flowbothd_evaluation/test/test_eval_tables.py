"""Tables: the paper's numbers where they belong, denominators that leave nothing out."""

import argparse
import json
import math

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
from flowbothd_common.errors import ParameterError
from flowbothd_common.types import Outcome
from flowbothd_evaluation.paper import tables_command
from flowbothd_evaluation.paper.methods import METHODS
from flowbothd_evaluation.paper.suites import PAPER_ROWS
from flowbothd_evaluation.paper.tables import _paper, compare, paper_row, rows_of, wilson
from flowbothd_evaluation.paper.tables_text import (
    category_table,
    comparison_table,
    detail_table,
    latex,
    markdown,
)
from flowbothd_evaluation.paper.trial import _ERRORS, failed

pytestmark = pytest.mark.ros

PER_STEP = {
    "open_ratio": [0.5, 1.0],
    "history_updated": [True, False],
    "grasp_switched": [False, True],
    "consistency_trials": [0, 3],
    "cosine": [0.9, None],
    "mean_error": [0.1, None],
    "rmse": [0.2, None],
}


def record(method="flowbothd", category="Door", thing="1", trial=0, *, opened=True, **changes):
    base = {
        "object": thing,
        "category": category,
        "target_mask": "truth",
        "trial": trial,
        "method": method,
        "switches": "SG+CC+HF" if method == "flowbothd" else "SG",
        "policy": "paper",
        "weights": "compact",
        "max_steps": 30,
        "base_seed": 0,
        "seed": trial,
        "link": "link_0",
        "joint": "joint_0",
        "outcome": "opened" if opened else "gave_up",
        "reason": "",
        "success": opened,
        "open_ratio": 1.0 if opened else 0.25,
        "normalized_distance": 0.0 if opened else 0.75,
        "steps": 2,
        "grasps": 1,
        "per_step": PER_STEP,
        "seconds": {"total": 1.0},
    }
    return {**base, **changes}


def no_contact(**words):
    found = record(opened=False, **words)
    return {**found, **failed("link_0", Outcome.NO_CONTACT, "nothing there")}


def test_averages_are_those_of_the_definition():
    records = [record(trial=n) for n in range(3)]
    records += [record(category="Laptop", thing="2", trial=n, opened=n > 0) for n in range(2)]
    (row,) = rows_of(records)
    assert row.success.mean == pytest.approx(4 / 5)
    assert row.success_by_category.mean == pytest.approx((1 + 1 / 2) / 2)
    assert row.distance.mean == pytest.approx(0.75 / 5)
    assert row.distance_by_category.mean == pytest.approx(0.75 / 4)
    assert row.categories["Laptop"] == (0.5, 0.375, 2)
    assert row.success.low < 0.8 < row.success.high
    assert (row.cosine, row.mean_error, row.rmse) == (0.9, 0.1, 0.2)


def test_failed_grasps_stay_in_the_denominator_and_the_other_convention_is_told():
    """The released code left them out, and the table looked better than the method."""
    records = [record(), no_contact(trial=1), no_contact(trial=2), record(trial=3, opened=False)]
    (row,) = rows_of(records)
    assert row.success.mean == 1 / 4 and row.released == 1 / 2
    assert row.outcomes == {"opened": 1, "no_contact": 2, "gave_up": 1}


def test_what_the_truth_cannot_open_is_counted_apart():
    shut = Outcome.UNOPENABLE_WITH_GROUND_TRUTH
    records = [record(), {**record(trial=1), **failed("link_0", shut, "filter")}]
    (row,) = rows_of(records)
    assert row.success.mean == 1.0 and row.unopenable == 1 and len(row.records) == 1


def test_a_row_of_errors_alone_has_no_numbers_but_is_there():
    records = [{**record(), **failed("link_0", Outcome.UNOPENABLE_WITH_GROUND_TRUTH, "")}]
    (row,) = rows_of(records)
    assert math.isnan(row.success.mean) and math.isnan(wilson(0, 0).low)
    assert "–" in markdown(category_table([row], "success"))


def test_the_papers_averages_follow_from_its_columns_where_it_is_consistent():
    """So no digit is mistyped; its mean distances over categories are off in the last six rows."""
    assert len(PAPER_ROWS) == 13
    counts = dict(zip(_paper()["categories"], _paper()["counts"], strict=True))
    off = []
    for table in ("success", "distance"):
        for row, ours in zip(_paper()[table], PAPER_ROWS, strict=True):
            assert (row["method"], row["switches"]) == (ours.method, "+".join(ours.switches))
            values = paper_row((row["method"], row["switches"], "paper", "truth"), table)
            weighted = sum(values[n] * counts[n] for n in counts) / sum(counts.values())
            assert weighted == pytest.approx(row["mean_s"], abs=0.0041)
            mean = sum(values.values()) / len(values)
            if mean != pytest.approx(row["mean_c"], abs=0.0021):
                off.append((table, row["method"], row["switches"]))
    assert off == [("distance", r.method, "+".join(r.switches)) for r in PAPER_ROWS[-6:]]
    assert paper_row(("flowbothd", "SG+CC+HF", "robot", "truth"), "success") == {}
    assert paper_row(("flowbothd", "SG+CC+HF", "paper", "none"), "success") == {}


def test_the_papers_row_stands_below_ours_for_the_categories_at_hand():
    table = category_table(rows_of([record(), record(category="Unknown", thing="9")]), "success")
    assert table[0][-2:] == ["Door (1)", "Unknown (1)"]
    assert table[2][0].strip() == "*the paper*"
    assert table[2][4:] == ["*0.77*", "*0.77*", "", "*0.77*", ""]


def test_rows_are_compared_on_the_same_trials_only():
    ours = [record(thing=str(n), opened=n != 3) for n in range(6)]
    theirs = [record("flowbot3d-md", thing=str(n), opened=n in (3, 4)) for n in range(5)]
    first, other = rows_of(ours + theirs)[::-1]
    assert first.key[0] == "flowbothd"
    found = compare(first, other)
    assert found.trials == 5 and found.difference.mean == pytest.approx((4 - 2) / 5)
    assert found.only_first == 3 and found.only_other == {"3 link_0": 1}
    assert "3 link_0 1x" in markdown(comparison_table(first, [found]))


def test_latex_escapes_what_it_must():
    text = latex(category_table(rows_of([record()]), "success"), "100 % of a_b")
    assert r"AVG\_c" in text and r"100 \% of a\_b" in text and r"$\checkmark$" in text
    assert r"\textit{0.77}" in text
    assert text.count(r"\\") == 3


def test_every_error_has_its_own_name():
    head = detail_table(rows_of([record()]))[0]
    assert {"mean error", "rmse", "cosine"} <= set(head)
    assert set(_ERRORS) == {"cosine", "mean_error", "rmse"}


def tables(*words):
    """Run the command that writes tables; errors come through."""
    parser = argparse.ArgumentParser()
    tables_command.add_arguments(parser)
    return tables_command.run(parser.parse_args(words))


def test_the_command_writes_one_report(tmp_path, capsys):
    import json

    results = tmp_path / "results.jsonl"
    lines = [record(), record(trial=1, opened=False), record("flowbot3d-md"), record("oracle")]
    results.write_text("".join(json.dumps(line) + "\n" for line in lines))
    out = tmp_path / "report"
    assert tables(str(results), "--out", str(out), "--no-analyses") == 0
    assert "FlowBotHD, our one-step variant" in capsys.readouterr().out
    page = (out / "README.md").read_text()
    assert "### FlowBotHD, our one-step variant, against the others" in page and "below 1" in page
    assert "implicit maximum likelihood" in page
    for picture in (line.split("](")[1].rstrip(")") for line in page.splitlines() if "![" in line):
        assert (out / picture).stat().st_size > 1000
    assert r"\begin{tabular}" in (out / "tables.tex").read_text()


def test_a_title_says_whose_network_it_is():
    """One-step models stood in the tables as FlowBotHD, next to the numbers of its diffusion."""
    shipped, other, truth = rows_of(
        [record(), record("flowbot3d-md", weights="runs/mine"), record("oracle", weights="")]
    )
    assert shipped.title == "FlowBotHD, our one-step variant"
    assert other.title == "FlowBot3D (MD), weights runs/mine"
    assert truth.title == "Ground truth"
    head = comparison_table(shipped, [compare(shipped, other)])
    assert head[0][0].startswith("FlowBotHD, our one-step variant [SG+CC+HF]")
    assert head[1][0] == "FlowBot3D (MD), weights runs/mine [SG]"


@pytest.mark.parametrize("name", [m.name for m in METHODS.values() if m.weights])
def test_shipped_weights_are_what_their_title_says(name):
    from flowbothd_model.checkpoint import read_checkpoint
    from flowbothd_model.config import Schedule
    from flowbothd_model.predictor import find_weights

    chosen = METHODS[name]
    config = read_checkpoint(find_weights(chosen.weights)).config
    implicit = config.diffusion.schedule is Schedule.IMPLICIT
    assert ("one-step" in chosen.titled()) == implicit
    assert config.sampling_steps == 1


def test_two_weights_are_not_mixed_in_one_row(tmp_path):
    """Weights trained anew have the same name."""
    old, new = record(weights_sha256="ab"), record(trial=1, weights_sha256="cd")
    path = tmp_path / "results.jsonl"
    path.write_text("".join(json.dumps(r) + "\n" for r in (old, new, record("oracle"))))
    with pytest.raises(ParameterError, match=r"FlowBotHD.*compact ab, compact cd"):
        tables(str(path), "--out", str(tmp_path / "report"))


@pytest.mark.parametrize("content", ["", '{"success": true}\n'])
def test_files_of_something_else_are_refused(tmp_path, content):
    results = tmp_path / "other.jsonl"
    results.write_text(content)
    with pytest.raises(ParameterError, match="holds no records"):
        tables(str(results), "--out", str(tmp_path))
