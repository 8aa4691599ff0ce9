"""The examples run as their docstrings say, in any folder, and show what they promise."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = sorted((Path(__file__).resolve().parent.parent / "examples").glob("*.py"))
LONGEST = 60
"""Lines; a longer one is no example but a program."""


def run(name: str, folder: Path, *arguments: str) -> str:
    (script,) = (path for path in EXAMPLES if path.stem == name)
    done = subprocess.run(
        [sys.executable, str(script), *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=170,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_there_is_one_example_for_each_of_five_tasks():
    assert [path.stem for path in EXAMPLES] == [
        "open_drawer_in_simulation",
        "plan_one_approach",
        "predict_flow_on_a_cloud",
        "replay_a_bag",
        "use_your_camera",
    ]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_says_how_it_is_run(path):
    text = path.read_text()
    assert len(text.splitlines()) <= LONGEST
    assert f"python examples/{path.name}" in ast.get_docstring(ast.parse(text))
    private = re.compile(r"import.* _\w|\w\._[a-z]")
    assert not private.search(text), "an example uses what a stranger may use"


@pytest.mark.long
def test_the_drawer_opens(tmp_path):
    said = run("open_drawer_in_simulation", tmp_path)
    assert "opened: " in said
    assert float(re.search(r"open ratio ([\d.]+)", said).group(1)) > 0.9
    assert re.search(r"s  step +sample accepted", said)


@pytest.mark.long
def test_the_approach_ends_before_the_wall(tmp_path):
    said = run("plan_one_approach", tmp_path)
    assert 0.02 < float(re.search(r"([\d.]+) m before the wall", said).group(1)) < 0.2


@pytest.mark.long
def test_an_approach_that_is_out_of_reach_says_so(tmp_path):
    with pytest.raises(AssertionError, match="no approach: "):
        run("plan_one_approach", tmp_path, "--contact", "2.0", "0.0", "0.4")


@pytest.mark.long
def test_the_cloud_of_a_camera_is_what_the_network_takes(tmp_path):
    said = run("use_your_camera", tmp_path, "--out", "cloud.npy")
    assert "'sampled': 1200" in said
    cloud = np.load(tmp_path / "cloud.npy")
    assert cloud.shape == (1200, 3) and np.isfinite(cloud).all()
    predicted = run("predict_flow_on_a_cloud", tmp_path, "cloud.npy", "--samples", "2")
    assert predicted.count("sample ") == 2 and "1200 points" in predicted
    assert "truth" not in predicted


@pytest.mark.long
def test_a_prediction_is_compared_with_the_truth_where_there_is_one(tmp_path):
    said = run("predict_flow_on_a_cloud", tmp_path)
    cosines = [float(value) for value in re.findall(r"truth ([+-][\d.]+)", said)]
    assert len(cosines) == 4 and all(-1.0 <= value <= 1.0 for value in cosines)
    assert max(cosines) > 0.2, "no sample resembles the truth"
