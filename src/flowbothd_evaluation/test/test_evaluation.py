"""The evaluation: one record a trial whatever happens, the same ones however it was run."""

import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flowbothd_common.errors import FlowBotError, ObjectModelError, ParameterError
from flowbothd_evaluation.paper import paper_command
from flowbothd_evaluation.paper.cases import PROCEDURAL, find_cases
from flowbothd_evaluation.paper.methods import (
    METHODS,
    every_combination,
    parse_switches,
    policy_params,
)
from flowbothd_evaluation.paper.procedural_folder import make_object
from flowbothd_evaluation.paper.suites import SUITES
from flowbothd_evaluation.paper.trial import PaperTrial, run_trial
from flowbothd_evaluation.record_files import from_json, read_records, to_json
from flowbothd_evaluation.records import PaperRecord, Seconds
from flowbothd_model.data.procedural.catalogue import make
from flowbothd_model.data.splits import NEVER_TRAINED_ON, held_out_ids
from flowbothd_model.predictor import find_weights

pytestmark = pytest.mark.timeout(300)

PARTNET = Path(__file__).parents[4] / "shared" / "data" / "partnet_mobility"
needs_data = pytest.mark.skipif(not PARTNET.is_dir(), reason="no PartNet-Mobility objects here")

DISHWASHER, MICROWAVE = "Dishwasher-1000000000", "Microwave-1000000000"


def case_of(name):
    return find_cases([PROCEDURAL], [name])[0]


def trial_of(case, link, method="oracle", **changes):
    chosen = METHODS[method]
    made = PaperTrial(case, link, 0, method, chosen.switches, "robot", chosen.weights, 30, 0)
    return replace(made, **changes)


def command(*words):
    """Run the command that evaluates; errors come through."""
    parser = argparse.ArgumentParser()
    paper_command.add_arguments(parser)
    return paper_command.run(parser.parse_args(words))


def evaluate(out, *arguments):
    return command("--objects", PROCEDURAL, "--ids", DISHWASHER, "--out", str(out), *arguments)


def without_times(records):
    return [replace(record, seconds=Seconds()) for record in records]


def test_the_truth_opens_a_procedural_object_and_chance_is_recorded_too():
    case = case_of(DISHWASHER)
    record = run_trial(trial_of(case, case.links[0]))
    assert record.success and record.outcome == "opened" and record.open_ratio > 0.9
    assert record.normalized_distance == pytest.approx(1 - record.open_ratio)
    steps = record.per_step
    assert {len(values) for values in vars(steps).values()} == {record.steps}
    assert steps.open_ratio[-1] == record.open_ratio
    assert min(steps.cosine) > 0.99 and max(steps.rmse) < 0.05
    by_chance = run_trial(trial_of(case, case.links[0], "random"))
    assert by_chance.steps >= 1 and max(by_chance.per_step.cosine) < 0.5
    for one in (record, by_chance):
        assert "NaN" not in to_json(one)
        assert from_json(PaperRecord, to_json(one), "here") == one


def test_without_a_target_the_link_that_opened_most_counts():
    case = case_of(MICROWAVE)
    record = run_trial(trial_of(case, ""))
    assert record.target_mask == "none" and record.link in case.links
    assert record.success
    assert record.key == trial_of(case, "").key


def test_the_same_trial_is_the_same_record():
    trial = trial_of(case_of(DISHWASHER), "link_1", "random", policy="paper")
    first, again = without_times([run_trial(trial), run_trial(trial)])
    assert first == again
    other = run_trial(replace(trial, trial=1))
    assert other.seed != first.seed and other.per_step != first.per_step


def test_a_simulated_procedural_object_is_the_one_that_was_trained_on():
    """Poses, axes and limits survive the way through URDF and meshes."""
    from sim_bridge.objects.registry import load_object

    thing = make("Refrigerator", 1_000_000_000)
    model = load_object(make_object(thing.name))
    movable = {f"joint_{i}": joint for i, joint in enumerate(thing.joints) if joint.movable}
    assert set(model.joints) == set(movable)
    for name, joint in movable.items():
        found = model.joints[name]
        np.testing.assert_allclose(found.axis, joint.axis, atol=1e-6)
        assert (found.lower, found.upper) == (joint.lower, joint.upper)
        if joint.kind == "revolute":
            np.testing.assert_allclose(found.point, joint.point, atol=1e-6)
    for index in range(len(thing.joints)):
        mine = thing.vertices[np.unique(thing.faces[thing.vertex_link[thing.faces[:, 0]] == index])]
        if len(mine):
            seen = model.links[f"link_{index}"].mesh.vertices
            np.testing.assert_allclose(seen.min(0), mine.min(0), atol=1e-5)
            np.testing.assert_allclose(seen.max(0), mine.max(0), atol=1e-5)


@pytest.fixture
def broken(tmp_path):
    """A folder with an object three ways: whole, without a mesh, without limits."""
    whole = make_object(DISHWASHER)
    for name in ("whole", "meshless", "limitless"):
        shutil.copytree(whole, tmp_path / name)
    next((tmp_path / "meshless").glob("*.obj")).unlink()
    urdf = tmp_path / "limitless" / "mobility.urdf"
    lines = [line for line in urdf.read_text().splitlines() if "<limit" not in line]
    urdf.write_text("\n".join(lines))
    return tmp_path


@pytest.mark.long
def test_what_cannot_be_simulated_has_its_records(broken, tmp_path, capsys):
    out = tmp_path / "results.jsonl"
    arguments = ("--method", "oracle", "--trials", "2", "--jobs", "1", "--out", str(out))
    assert command("--objects", str(broken), *arguments) == 0
    records = read_records(out, PaperRecord)
    cases = find_cases([str(broken)])
    assert len(records) == sum(len(case.links) for case in cases) * 2 == 6
    # What the truth cannot even try is no failure of a method: it never was a trial.
    shut = {r.outcome for r in records if r.object != "whole"}
    assert shut == {"unopenable_with_ground_truth"}
    said = capsys.readouterr().out
    assert "meshless link_1 (error)" in said and "limitless link_1 (error)" in said
    trials = {case.name: run_trial(trial_of(case, "link_1")) for case in cases}
    assert trials["meshless"].outcome == "error" and ".obj" in trials["meshless"].reason
    assert "limits" in trials["limitless"].reason


def test_a_link_that_cannot_be_seen_is_not_visible(tmp_path):
    """The inner one of two boxes: nothing of it is in any picture."""
    folder = tmp_path / "hidden"
    folder.mkdir()
    (folder / "mobility.urdf").write_text(
        """<robot name="hidden"><link name="base"/>
        <link name="shell"><visual><geometry><box size="1 1 1"/></geometry></visual>
        <collision><geometry><box size="1 1 1"/></geometry></collision></link>
        <link name="inside"><visual><geometry><box size="0.2 0.2 0.2"/></geometry></visual>
        <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
        <joint name="fixed" type="fixed"><parent link="base"/><child link="shell"/></joint>
        <joint name="slide" type="prismatic"><parent link="base"/><child link="inside"/>
        <axis xyz="1 0 0"/><limit lower="0" upper="0.1"/></joint></robot>"""
    )
    (case,) = find_cases([str(folder)])
    record = run_trial(trial_of(case, "inside"))
    assert record.outcome == "not_visible" and not record.success


def test_an_unexpected_failure_is_a_record_as_well(monkeypatch):
    from flowbothd_evaluation.paper import trial as module

    def fails(*_):
        raise RuntimeError("the simulator went away")

    monkeypatch.setattr(module, "FloatingWorld", fails)
    record = run_trial(trial_of(case_of(DISHWASHER), "link_1"))
    assert record.outcome == "error" and "went away" in record.reason


@pytest.mark.long
def test_records_do_not_depend_on_the_number_of_processes(tmp_path):
    results = []
    for jobs in ("1", "3"):
        out = tmp_path / jobs / "results.jsonl"
        arguments = ("--method", "random", "--trials", "4", "--jobs", jobs, "--no-filter")
        assert evaluate(out, *arguments) == 0
        records = {r.key: r for r in without_times(read_records(out, PaperRecord))}
        assert len(records) == 4
        results.append(records)
    assert results[0] == results[1]


@pytest.mark.long
def test_twenty_interruptions_lose_and_double_nothing(tmp_path):
    """SIGKILL at random moments; the last run is left to end."""
    out = tmp_path / "results.jsonl"
    program = tmp_path / "flowbothd_stub.py"
    program.write_text(STUB)
    command = [sys.executable, str(program), str(out)]
    draw = random.Random(5)
    for _ in range(20):
        process = subprocess.Popen(
            command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        before = out.stat().st_size if out.exists() else 0
        deadline = time.monotonic() + 60
        # Some are killed while they start, most while they write.
        grown = draw.choice((0, 1, 200, 700))
        while time.monotonic() < deadline and process.poll() is None:
            size = out.stat().st_size if out.exists() else 0
            if size >= before + grown:
                break
            time.sleep(draw.uniform(0.001, 0.01))
        os.killpg(process.pid, signal.SIGKILL)
        process.wait(timeout=20)
        if draw.random() < 0.3 and out.exists():
            # A machine that loses power leaves half a line.
            with out.open("ab") as file:
                file.write(b'{"number": 3, "va')
    subprocess.run(command, check=True, timeout=120, capture_output=True)
    records = [json.loads(line) for line in out.read_text().splitlines()]
    assert sorted(r["number"] for r in records) == list(range(400))
    assert all(r["value"] == r["number"] ** 2 for r in records)


STUB = """
import sys, time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from flowbothd_evaluation.resumable import run_resumable

@dataclass
class Square:
    KIND: ClassVar[str] = "square"
    number: int
    value: int

    @property
    def key(self):
        return self.number

def square(number):
    time.sleep(0.01)
    return Square(number, number ** 2)

if __name__ == "__main__":
    run_resumable({n: n for n in range(400)}, square, Square, Path(sys.argv[1]), 2)
"""


@pytest.mark.long
def test_weights_trained_anew_are_tried_anew(tmp_path):
    """Records of other weights by the same name do not count as done."""
    weights = tmp_path / "mine.safetensors"
    shutil.copy(find_weights("compact-no-diffusion"), weights)
    out = tmp_path / "out.jsonl"
    arguments = ("--method", "flowbothd-nodiffusion", "--trials", "1", "--steps", "1", "--jobs")
    arguments += ("1", "--no-filter", "--weights", f"flowbothd-nodiffusion={weights}")
    assert evaluate(out, *arguments) == 0
    first = read_records(out, PaperRecord)
    assert evaluate(out, *arguments) == 0
    assert read_records(out, PaperRecord) == first
    shutil.copy(find_weights("compact-flowbot3d-ro"), weights)
    assert evaluate(out, *arguments) == 0
    both = read_records(out, PaperRecord)
    assert len(both) == 2 * len(first)
    assert {r.weights for r in both} == {str(weights)}
    assert len({r.weights_sha256 for r in both}) == 2


def test_two_commands_do_not_write_the_same_file(tmp_path):
    from flowbothd_evaluation.resumable import _locked

    out = tmp_path / "results.jsonl"
    with _locked(out), pytest.raises(ParameterError, match="another command"), _locked(out):
        pass


def test_a_file_of_something_else_is_not_written_to(tmp_path):
    out = tmp_path / "results.jsonl"
    out.write_text("not a record\n")
    with pytest.raises(ParameterError):
        evaluate(out, "--method", "oracle", "--trials", "1")
    assert out.read_text() == "not a record\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--method", "magic"), "flowbot3d-ro"),
        (("--switches", "SG+XX"), "SG, CC, HF"),
        (("--trials", "0"), ">= 1"),
        (("--jobs", "0"), ">= 1"),
        (("--weights", "flowbothd"), "METHOD=PATH"),
        (("--weights", "flowbothd=no/such/weights"), "no/such/weights"),
        (("--suite", "small", "--method", "oracle"), "leave out"),
        (("--suite", "small", "--ids", "nobody"), "nobody"),
    ],
)
def test_bad_input_is_named_before_anything_runs(tmp_path, arguments, said):
    out = tmp_path / "results.jsonl"
    with pytest.raises(FlowBotError, match=re.escape(said)):
        evaluate(out, *arguments)
    assert not out.exists()


def test_switches_reach_the_policy():
    assert len(set(every_combination())) == 8
    assert parse_switches("HF+SG") == ("SG", "HF") and parse_switches("none") == ()
    for switches in every_combination():
        params = policy_params(METHODS["flowbothd"], switches, "paper", 30, 7)
        on = (params.switch_grasp, params.consistency_check, params.history_filter)
        assert on == tuple(name in switches for name in ("SG", "CC", "HF"))
        assert not params.reject_failed_directions and params.seed == 7
    with pytest.raises(ParameterError, match="policy"):
        policy_params(METHODS["oracle"], (), "mine", 30, 0)


def test_suites_hold_nothing_that_was_trained_on():
    allowed = {*held_out_ids(), *NEVER_TRAINED_ON}
    for suite in SUITES.values():
        assert set(suite.ids) <= allowed and len(set(suite.ids)) == len(suite.ids)
        assert len(set(suite.rows)) == len(suite.rows)


def test_procedural_sets_are_named_and_counted():
    assert len(find_cases([PROCEDURAL])) == 21
    assert len(find_cases([PROCEDURAL + ":2"])) == 42
    for wrong in ("procedural:train", "procedural:test:0", "procedural:test:x"):
        with pytest.raises(ObjectModelError, match="procedural"):
            find_cases([wrong])


@needs_data
def test_downloads_are_taken_as_they_are():
    """One folder has neither meta.json nor semantics, the other all that was published."""
    door, cabinet = find_cases([str(PARTNET / "raw" / name) for name in ("8994", "41083")])
    assert door.category == "Door" and door.links == door.openable == ("link_2",)
    assert cabinet.category == "StorageFurniture" and len(cabinet.openable) == 4
    small = find_cases([str(PARTNET / "train"), str(PARTNET / "raw" / "8994")], SUITES["small"].ids)
    assert len(small) == 12 and sum(len(case.openable) for case in small) <= 20


@needs_data
@pytest.mark.long
def test_the_truth_opens_the_door_and_the_drawers_of_the_demonstrations():
    for case in find_cases([str(PARTNET / "raw")]):
        for link in case.openable:
            assert run_trial(trial_of(case, link)).success, (case.name, link)
