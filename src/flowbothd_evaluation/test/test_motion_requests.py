"""Random motion requests: a few of the ten thousand that `flowbothd bench motion` runs."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from flowbothd_common.motion import JointState, MotionKind
from flowbothd_evaluation.benchmarks.bench_motion import (
    _PARTS,
    _PLANNING,
    _timing_split,
    run_shard,
    summarise,
)
from flowbothd_evaluation.benchmarks.motion_requests import (
    Verdict,
    draw,
    run_request,
    worst_between,
)
from franka_suction_driver.arm.kinematics import make_kinematics
from franka_suction_driver.arm.trajectory import joint_move
from franka_suction_driver.execution.executor import MotionExecutor
from franka_suction_driver.simulated import sim_motion_params


@pytest.fixture(scope="module")
def verdicts() -> list[Verdict]:
    """Seeds that the benchmark does not use."""
    return [v for seed in (1000, 1001) for v in run_shard(seed, 30)]


@pytest.mark.long
def test_no_sample_of_any_request_breaks_a_limit(verdicts: list[Verdict]) -> None:
    """The incident: increments of a probe went out unchecked, at 86 times an acceleration limit."""
    assert [v.fault for v in verdicts if v.fault] == []
    assert {v.kind for v in verdicts} == {kind.value for kind in MotionKind}


@pytest.mark.long
def test_between_the_samples_the_limits_hold_too(verdicts: list[Verdict]) -> None:
    worst = max(verdicts, key=lambda v: v.fine_ratio)
    assert worst.fine_ratio < 1.02, worst


@pytest.mark.long
def test_every_motion_ends_at_rest_and_free_steps_are_straight(verdicts: list[Verdict]) -> None:
    assert max(v.end_speed for v in verdicts) == 0.0
    steps = [v for v in verdicts if v.bend > 0]
    assert len(steps) > 5
    assert max(v.bend for v in steps) < 1e-3


def test_the_same_seed_asks_and_gets_the_same() -> None:
    first, second = (run_shard(7, 4) for _ in range(2))
    still = [[replace(v, planning=0.0, wall=0.0) for v in verdicts] for verdicts in (first, second)]
    assert still[0] == still[1]


def test_the_check_sees_what_happens_between_samples() -> None:
    """A trajectory whose points are all fine, but whose first point lies too far from the start."""
    params = sim_motion_params()
    executor = MotionExecutor(make_kinematics(params), params, 0)
    start = np.array(params.robot.start_positions)
    names = executor.robot.joint_names
    trajectory = joint_move(names, JointState.at_rest(start), start + 0.2, executor.limits)
    good, _ = worst_between(executor.limits, JointState.at_rest(start), trajectory)
    assert good <= 1.0
    jump, what = worst_between(executor.limits, JointState.at_rest(start + 0.05), trajectory)
    assert jump > 1.5
    assert what in ("jerk", "acceleration", "velocity")


def test_planning_alone_leaves_the_executor_free() -> None:
    params = sim_motion_params()
    executor = MotionExecutor(make_kinematics(params), params, 0)
    rng = np.random.default_rng(3)
    for _ in range(5):
        executor.set_obstacles(None)
        assert run_request(executor, draw(executor, rng), only_planning=True).planning >= 0
        assert not executor.busy


def test_the_summary_counts_everything() -> None:
    made = [Verdict("probe", "reached", 0.01, 0.02, trajectories=1), Verdict("probe", "rejected")]
    row = summarise(made)["probe"]
    assert row["requests"] == 2
    assert row["reasons"] == {"reached": 1, "rejected": 1}
    assert row["planning_median_ms"] == 10.0


def test_the_parts_of_planning_are_modules_that_exist() -> None:
    """A renamed module would otherwise be counted as the rest, without a word."""
    modules = [module for modules in _PARTS.values() for module in modules]
    modules.append(_PLANNING)
    assert [name for name in modules if importlib.util.find_spec(name) is None] == []


@pytest.mark.long
def test_the_shares_of_planning_add_up_and_most_of_an_approach_is_known() -> None:
    split = _timing_split(12)
    assert "approach" in split
    for parts in split.values():
        assert sum(parts.values()) == pytest.approx(1.0, abs=0.01)
        assert set(parts) <= {*_PARTS, "rest"}
    assert split["approach"]["inverse kinematics"] > 0.4
    assert split["approach"]["rest"] < 0.4
