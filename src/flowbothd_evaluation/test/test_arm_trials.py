"""Trials of the arm: one record each, continued after an interruption, no worker left behind."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import psutil
import pytest

from flowbothd_evaluation.arm.arm_command import run_trials
from flowbothd_evaluation.arm.table import table
from flowbothd_evaluation.arm.trials import METHODS, ArmTrial, door_trials, run_trial
from flowbothd_evaluation.record_files import to_json

TRIAL = ArmTrial("partnet", "floating", "cabinet_door", "", "", "oracle", 0)


def test_the_door_suite_has_every_mode_seed_and_method_once():
    trials = list(door_trials(list(METHODS), 5))
    assert len(trials) == len({trial.key for trial in trials}) == 4 * 5 * 3


def test_whatever_happens_is_a_record():
    trial = replace(TRIAL, object="no/such/folder")
    record = run_trial(trial)
    assert not record.success and record.outcome == "error"
    assert "no/such/folder" in record.reason
    assert record.key == trial.key


@pytest.mark.long
def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path):
    out = tmp_path / "trials.jsonl"
    first = run_trials([TRIAL], out, jobs=1)
    assert first[0].success
    marked = replace(first[0], reason="kept from the first run")
    # The last line was being written when the run was killed.
    out.write_text(to_json(marked) + "\n" + to_json(first[0])[:40])
    again = run_trials([TRIAL], out, jobs=1)
    assert again == [marked]
    assert len(out.read_text().splitlines()) == 1
    assert "1 of 1" in table(again)


def test_the_table_counts_by_mode_and_names_why_a_part_stayed_shut():
    opened = run_trial(replace(TRIAL, object="no/such/folder"))
    opened = replace(opened, object="door", mode="pull_left", success=True, open_ratio=1.0)
    shut = replace(opened, seed=1, success=False, open_ratio=0.25, reason="a | b", steps=3)
    touched = replace(shut, mode="push_left", contacts={"panda_link4 - leaf": 31.4})
    head, _, *rows = table([opened, shut, touched]).splitlines()
    assert head.startswith("| object | mode or joint | method | opened |")
    assert "| 1 of 2 | 0 | 0.62 | 1.5 |" in rows[0] and "error: a \\| b" in rows[0]
    assert "1 runs, up to 31" in rows[1] and "never" in rows[0]
    assert rows[-1] == "| door | oracle | **1 of 3** |"


PROGRAM = """
import argparse
from flowbothd_evaluation.arm import arm_command
parser = argparse.ArgumentParser()
arm_command.add_arguments(parser)
raise SystemExit(arm_command.run(parser.parse_args()))
"""


@pytest.mark.long
def test_no_worker_outlives_a_killed_command(tmp_path):
    """The incident: killed trials went on in the background and slowed everything else down."""
    command = [sys.executable, "-c", PROGRAM, "--suite", "door"]
    process = subprocess.Popen(
        [*command, "--out", str(tmp_path / "trials.jsonl")],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    deadline = time.monotonic() + 60
    workers: list[psutil.Process] = []
    while len(workers) < 2 and time.monotonic() < deadline:
        children = psutil.Process(process.pid).children(recursive=True)
        workers = [c for c in children if "spawn_main" in " ".join(c.cmdline())]
        time.sleep(0.1)
    # A worker follows once it has imported its modules; it does so before its first trial.
    while time.monotonic() < deadline and any(len(w.threads()) < 2 for w in workers):
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.wait(timeout=10)
    _, alive = psutil.wait_procs(workers, timeout=60)
    assert workers and not alive
