"""Trials: one record each, continued after an interruption, no worker left behind."""

import json
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
from flowbothd_evaluation.trials import METHODS, Trial, door_trials, run_trial, run_trials, table

pytestmark = pytest.mark.ros

TRIAL = Trial("partnet", "floating", "cabinet_door", "", "", "oracle", 0)


def test_the_door_suite_has_every_mode_seed_and_method_once():
    trials = list(door_trials(list(METHODS), 5))
    assert len(trials) == len(set(trials)) == 4 * 5 * 3


def test_whatever_happens_is_a_record():
    entry = run_trial(Trial("partnet", "floating", "no/such/folder", "", "", "oracle", 0))
    assert entry["success"] is False and entry["outcome"] == "error"
    assert "no/such/folder" in entry["reason"]


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path):
    out = tmp_path / "trials.jsonl"
    first = run_trials([TRIAL], out, jobs=1)
    assert first[0]["success"] is True
    marked = {**first[0], "reason": "kept from the first run"}
    # The last line was being written when the run was killed.
    out.write_text(json.dumps(marked) + "\n" + json.dumps(first[0])[:40])
    again = run_trials([TRIAL], out, jobs=1)
    assert again == [marked]
    assert len(out.read_text().splitlines()) == 1
    assert "1 of 1" in table(again)


PROGRAM = """
import argparse
from flowbothd_evaluation import trials
parser = argparse.ArgumentParser()
trials.add_arguments(parser)
raise SystemExit(trials.run(parser.parse_args()))
"""


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
