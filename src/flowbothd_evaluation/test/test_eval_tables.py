"""Tables: the paper's numbers where they belong, denominators that leave nothing out."""

import argparse
import math
from dataclasses import replace

import pytest

from flowbothd_common.errors import ParameterError
from flowbothd_common.types import Outcome
from flowbothd_evaluation import report_command
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
from flowbothd_evaluation.record_files import RecordError, to_json
from flowbothd_evaluation.records import PaperRecord, PullSignals, Seconds

PER_STEP = PullSignals(
    open_ratio=(0.5, 1.0),
    history_updated=(True, False),
    grasp_switched=(False, True),
    consistency_trials=(0, 3),
    cosine=(0.9, None),
    mean_error=(0.1, None),
    rmse=(0.2, None),
)


def record(method="flowbothd", category="Door", thing="1", trial=0, *, opened=True, **changes):
    made = PaperRecord(
        object=thing,
        category=category,
        target_mask="truth",
        trial=trial,
        method=method,
        switches="SG+CC+HF" if method == "flowbothd" else "SG",
        policy="paper",
        weights="compact",
        weights_sha256="",
        max_steps=30,
        base_seed=0,
        seed=trial,
        link="link_0",
        joint="joint_0",
        outcome=Outcome.OPENED if opened else Outcome.GAVE_UP,
        reason="",
        success=opened,
        open_ratio=1.0 if opened else 0.25,
        normalized_distance=0.0 if opened else 0.75,
        steps=2,
        grasps=1,
        per_step=PER_STEP,
        seconds=Seconds(wall=1.0),
    )
    return replace(made, **changes)


def nothing_pulled(outcome, **words):
    shut = record(opened=False, **words)
    return replace(
        shut,
        outcome=outcome,
        open_ratio=0.0,
        normalized_distance=1.0,
        steps=0,
        per_step=PullSignals(),
    )


def written(path, records):
    path.write_text("".join(to_json(record) + "\n" for record in records))
    return path


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
    records = [record(), record(trial=3, opened=False)]
    records += [nothing_pulled(Outcome.NO_CONTACT, trial=n) for n in (1, 2)]
    (row,) = rows_of(records)
    assert row.success.mean == 1 / 4 and row.released == 1 / 2
    assert row.outcomes == {"opened": 1, "no_contact": 2, "gave_up": 1}


def test_what_the_truth_cannot_open_is_counted_apart():
    records = [record(), nothing_pulled(Outcome.UNOPENABLE_WITH_GROUND_TRUTH, trial=1)]
    (row,) = rows_of(records)
    assert row.success.mean == 1.0 and row.unopenable == 1 and len(row.records) == 1


def test_a_row_of_errors_alone_has_no_numbers_but_is_there():
    (row,) = rows_of([nothing_pulled(Outcome.UNOPENABLE_WITH_GROUND_TRUTH)])
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


def report(*words):
    """Run the command that writes the report; errors come through."""
    parser = argparse.ArgumentParser()
    report_command.add_arguments(parser)
    return report_command.run(parser.parse_args([str(word) for word in words]))


def test_the_command_writes_one_report(tmp_path, capsys):
    records = [record(), record(trial=1, opened=False), record("flowbot3d-md"), record("oracle")]
    out = tmp_path / "report"
    assert report(written(tmp_path / "results.jsonl", records), "--out", out) == 0
    assert "FlowBotHD, our one-step variant" in capsys.readouterr().out
    page = (out / "README.md").read_text()
    assert "### FlowBotHD, our one-step variant, against the others" in page and "below 1" in page
    assert "implicit maximum likelihood" in " ".join(page.split())
    for picture in (line.split("](")[1].rstrip(")") for line in page.splitlines() if "![" in line):
        assert (out / picture).stat().st_size > 1000
    assert r"\begin{tabular}" in (out / "tables.tex").read_text()


def test_a_title_says_whose_network_it_is():
    """One-step models stood in the tables as FlowBotHD, next to the numbers of its diffusion."""
    other, shipped, truth = rows_of(
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
    path = written(tmp_path / "results.jsonl", (old, new, record("oracle")))
    with pytest.raises(ParameterError, match=r"FlowBotHD.*compact ab, compact cd"):
        report(path, "--out", tmp_path / "report")


@pytest.mark.parametrize("content", ["", '{"success": true}\n'])
def test_files_of_something_else_are_refused(tmp_path, content):
    results = tmp_path / "other.jsonl"
    results.write_text(content)
    with pytest.raises(RecordError, match=r"other\.jsonl.*no record"):
        report(results, "--out", tmp_path)


def test_a_report_of_nothing_says_what_to_give(tmp_path):
    with pytest.raises(ParameterError, match="files of records, or --analyses"):
        report("--out", tmp_path)
