"""Records as files: what is read is what was written, now and before records had a version."""

from __future__ import annotations

import argparse
import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flowbothd_common.types import Outcome
from flowbothd_evaluation import report_command
from flowbothd_evaluation.arm.arm_command import run_trials
from flowbothd_evaluation.arm.trials import ArmTrial
from flowbothd_evaluation.openings.search import Place
from flowbothd_evaluation.openings.search_command import PlacesRecord
from flowbothd_evaluation.openings.task import key_of, load_openings
from flowbothd_evaluation.record_files import (
    RecordError,
    from_json,
    read_any,
    read_records,
    to_json,
)
from flowbothd_evaluation.records import ArmRecord, OpeningRecord, PaperRecord

OLD = Path(__file__).parent / "records_version_0"
"""Files that the experiments wrote before records had a version."""

KINDS = {"paper": PaperRecord, "arm": ArmRecord, "openings": OpeningRecord}


def old(name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (OLD / f"{name}.jsonl").read_text().splitlines()]


def test_old_trials_of_the_paper_keep_every_value() -> None:
    records = read_records(OLD / "paper.jsonl", PaperRecord)
    for plain, record in zip(old("paper"), records, strict=True):
        per_step, seconds = plain.pop("per_step"), plain.pop("seconds")
        assert {name: getattr(record, name) for name in plain} == plain
        assert {k: list(v) for k, v in vars(record.per_step).items()} == per_step
        assert record.seconds.wall == seconds["total"]
        assert record.seconds.predicting == seconds["predict"]
        assert record.seconds.world == seconds["world"]
    assert [r.target for r in records if r.target_mask == "none"] == [""]


def test_old_records_without_a_hash_of_their_weights_are_read() -> None:
    """The first evaluations had none; they are records of weights by name alone."""
    (plain, *_) = old("paper")
    del plain["weights_sha256"]
    assert from_json(PaperRecord, json.dumps(plain), "here").weights_sha256 == ""


def test_old_trials_of_the_arm_keep_every_value() -> None:
    records = read_records(OLD / "arm.jsonl", ArmRecord)
    for plain, record in zip(old("arm"), records, strict=True):
        assert record.seconds.wall == plain.pop("wall_s", 0.0)
        assert record.seconds.simulated == plain.pop("sim_s", 0.0)
        assert {name: getattr(record, name) for name in plain} == plain
    failed = records[-1]
    assert failed.outcome is Outcome.ERROR and failed.steps == 0 and failed.contacts == {}


def test_old_openings_keep_every_value_and_are_runs_of_their_pose() -> None:
    (record,) = read_records(OLD / "openings.jsonl", OpeningRecord)
    (plain,) = old("openings")
    assert record.key == key_of(load_openings()[record.task], record.seed)
    assert record.seconds.wall == plain.pop("wall_s")
    assert record.seconds.simulated == plain.pop("sim_s")
    planning = {kind: list(times) for kind, times in record.planning_ms.items()}
    assert planning == plain.pop("planning_ms")
    for name, value in plain.items():
        kept = getattr(record, name)
        assert (list(kept) if isinstance(kept, tuple) else kept) == value


def test_a_run_goes_on_in_an_old_file(tmp_path: Path) -> None:
    """Hours of trials must not be done again because their format has a name now."""
    out = tmp_path / "trials.jsonl"
    before = (OLD / "arm.jsonl").read_text()
    out.write_text(before)
    trial = ArmTrial("partnet", "floating", "no/such/folder", "", "", "oracle", 0)
    (record,) = run_trials([trial], out, jobs=1)
    assert record.outcome == "error"
    assert out.read_text() == before


@pytest.mark.parametrize("name", KINDS)
def test_what_is_written_is_read_again(name: str, tmp_path: Path) -> None:
    records = read_records(OLD / f"{name}.jsonl", KINDS[name])
    file = tmp_path / "new.jsonl"
    file.write_text("".join(to_json(record) + "\n" for record in records))
    assert read_any(file) == records
    assert all(json.loads(line)["version"] == 1 for line in file.read_text().splitlines())
    packed = tmp_path / "new.jsonl.gz"
    packed.write_bytes(gzip.compress(file.read_bytes()))
    assert read_any(packed) == records


def test_places_of_a_search_are_read_again_old_and_new() -> None:
    place = Place((0.4, -0.1), 15.0, (0.2, 0.01), 1.0, 0.3, 0.2, 0.015)
    record = PlacesRecord("drawer", 3, (place,))
    assert from_json(PlacesRecord, to_json(record), "here") == record
    plain = {k: v for k, v in json.loads(to_json(record)).items() if k not in ("record", "version")}
    assert from_json(PlacesRecord, json.dumps(plain), "here") == record


def without(name: str) -> Callable[[dict[str, Any]], None]:
    return lambda plain: plain.pop(name)


def with_value(**changes: Any) -> Callable[[dict[str, Any]], None]:
    return lambda plain: plain.update(changes)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (without("grasps"), "fields are missing; got grasps"),
        (with_value(colour="red"), "unknown fields; got colour"),
        (with_value(steps="3"), "field steps; got '3'; allowed: int"),
        (with_value(success=1), "field success; got 1; allowed: bool"),
        (with_value(outcome="ajar"), "field outcome; got 'ajar'; allowed: opened, not_opened"),
        (with_value(contacts={"a - b": None}), "field contacts.a - b; got None; allowed: float"),
        (with_value(seconds=[1.0]), "field seconds; got [1.0]; allowed: the fields of Seconds"),
        (with_value(seconds={"wall": 1.0}), "fields are missing; got seconds.simulated"),
        (with_value(version=2), "unknown version of a record; got 2; allowed: 0 to 1"),
        (with_value(record="opening"), "wrong kind of record; got opening; allowed: arm"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(
    change: Callable[[dict[str, Any]], None], said: str, tmp_path: Path
) -> None:
    line = to_json(read_records(OLD / "arm.jsonl", ArmRecord)[0])
    plain = json.loads(line)
    change(plain)
    file = tmp_path / "trials.jsonl"
    file.write_text(f"{line}\n{json.dumps(plain)}\n")
    with pytest.raises(RecordError) as caught:
        read_records(file, ArmRecord)
    assert f"{file}, line 2: {said}" in str(caught.value)


def test_a_file_that_is_not_there_or_damaged_is_an_error_of_the_report(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"missing\.jsonl cannot be read"):
        read_any(tmp_path / "missing.jsonl")
    torn = tmp_path / "torn.jsonl.gz"
    torn.write_bytes(gzip.compress(b"{}\n" * 100)[:-9])
    with pytest.raises(RecordError, match=r"torn\.jsonl\.gz cannot be read"):
        read_any(torn)


def test_one_report_has_all_experiments_and_reads_old_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = argparse.ArgumentParser()
    report_command.add_arguments(parser)
    files = [str(OLD / f"{name}.jsonl") for name in KINDS]
    assert report_command.run(parser.parse_args([*files, "--out", str(tmp_path)])) == 0
    page, said = (tmp_path / "README.md").read_text(), capsys.readouterr().out
    assert "Only points of the target link may be grasped" in page
    for text in (page, said):
        assert "| custom_door | model:compact-doors | **1 of 1** |" in text
        assert "| drawer | 19.8 cm | 21.5 / 21.5 | 1 | 1 | **1 of 1** |" in text
    assert "From the networks" not in page
