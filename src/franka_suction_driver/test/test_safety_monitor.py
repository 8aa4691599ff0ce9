"""The safety envelope as the executor keeps it: box, speed, force, lag, latch, dry run, audit."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flowbothd_common.errors import MotionRejectedError, ParameterError
from flowbothd_common.motion import MotionGoal, MotionKind, MotionReason
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.execution.audit import AuditLog
from franka_suction_driver.execution.executor import MotionExecutor
from franka_suction_driver.execution.safety_monitor import slowed, workspace
from franka_suction_driver.params import MotionParams, SafetyParams
from franka_suction_driver.planning.inverse_kinematics import solve

FORWARD = np.array([1.0, 0, 0])
RETREAT = MotionGoal(MotionKind.RETREAT)


def approach(x: float = 0.55, y: float = 0.1, z: float = 0.3) -> MotionGoal:
    return MotionGoal(MotionKind.APPROACH, np.array([x, y, z]), -FORWARD)


def step(direction: np.ndarray, distance: float = 0.05) -> MotionGoal:
    return MotionGoal(MotionKind.FLOW_STEP, None, direction, distance)


@pytest.fixture
def make_executor(robot: Kinematics, motion_params: MotionParams) -> Callable[..., MotionExecutor]:
    def make(audit: Any = None, **safety: Any) -> MotionExecutor:
        params = replace(motion_params, safety=replace(motion_params.safety, **safety))
        return MotionExecutor(robot, params, seed=1, audit=audit)

    return make


@pytest.fixture
def facing(robot: Kinematics, limits: JointLimits) -> np.ndarray:
    """A roomy configuration with the tool pointing forward at (0.55, -0.1, 0.5)."""
    box = limits.box(0.1)
    seeds = box.sample(np.random.default_rng(0), 256)
    found = solve(robot, box, seeds, np.array([0.55, -0.1, 0.5]), FORWARD)
    return found[int(np.argmax(box.margin(found)))]


def test_a_robot_that_nobody_has_set_up_moves_at_a_tenth_of_the_speed(
    robot: Kinematics, make_arm: Callable
) -> None:
    assert SafetyParams().speed_scale == 0.1
    params = slowed(MotionParams())
    assert params.flow_step.speed == pytest.approx(0.1 * MotionParams().flow_step.speed)
    assert params.probe.free_speed == pytest.approx(0.1 * MotionParams().probe.free_speed)
    arm = make_arm()
    executor = MotionExecutor(robot, MotionParams(), seed=1)
    assert arm.run(executor, approach(), limit=120.0).reason is MotionReason.REACHED
    fastest = max(float(np.abs(t.velocities).max()) for _, _, t in arm.issued)
    assert fastest <= 0.1 * 0.5 * 2.61


def test_a_slower_scale_takes_longer_over_the_same_way(
    make_executor: Callable, make_arm: Callable
) -> None:
    durations = []
    for scale in (1.0, 0.5, 0.2):
        arm = make_arm()
        result = arm.run(make_executor(speed_scale=scale), approach(), limit=120.0)
        durations.append(result.duration)
    assert durations == sorted(durations)
    assert durations[2] > 2 * durations[0]


def test_contacts_outside_the_box_are_refused_with_the_box(
    make_executor: Callable, make_arm: Callable
) -> None:
    executor = make_executor(workspace_min=(0.0, -0.5, 0.0), workspace_max=(0.8, 0.5, 0.8))
    with pytest.raises(MotionRejectedError, match=r"outside the workspace box.*0\.9.*0\.8, 0\.5"):
        executor.start(approach(x=0.9), make_arm().observe())


def test_no_sample_of_an_approach_leaves_the_box(
    make_executor: Callable, make_arm: Callable, robot: Kinematics
) -> None:
    high = (0.6, 0.3, 0.62)
    arm = make_arm()
    executor = make_executor(workspace_min=(0.2, -0.3, 0.02), workspace_max=high)
    for y in (-0.2, 0.2):
        result = arm.run(executor, approach(x=0.55, y=y, z=0.25))
        assert result.reason is MotionReason.REACHED, result.message
    for _, _, trajectory in arm.issued:
        tips = robot.tip(trajectory.positions).position
        assert (tips <= np.array(high) + 1e-3).all()
        assert (tips[:, 2] >= 0.02 - 1e-3).all()


def test_a_step_ends_at_the_edge_of_the_box(
    make_executor: Callable, make_arm: Callable, facing: np.ndarray
) -> None:
    arm = make_arm(facing)
    arm.vacuum = lambda tip: True
    executor = make_executor(workspace_min=(0.52, -1.0, 0.0), workspace_max=(1.0, 1.0, 1.0))
    result = arm.run(executor, step(-FORWARD))
    assert result.reason is MotionReason.COLLISION
    assert "edge of the workspace" in result.message
    assert 0.2 < result.reached_fraction < 0.8
    assert min(tip[0] for tip in arm.tips) > 0.519


def test_an_arm_outside_the_box_may_come_back_but_not_go_further(
    make_executor: Callable, make_arm: Callable, facing: np.ndarray
) -> None:
    executor = make_executor(workspace_min=(0.0, -1.0, 0.0), workspace_max=(0.5, 1.0, 1.0))
    arm = make_arm(facing)
    arm.vacuum = lambda tip: True
    further = arm.run(executor, step(FORWARD))
    assert further.reason is MotionReason.UNREACHABLE
    assert "would leave the workspace box at x" in further.message
    assert arm.tip[0] == pytest.approx(0.55, abs=2e-3)
    assert arm.run(executor, step(-FORWARD)).reason is MotionReason.REACHED


def test_an_empty_box_is_an_error() -> None:
    with pytest.raises(ParameterError, match="workspace box is empty"):
        workspace(SafetyParams(workspace_min=(0.5, 0.0, 0.0), workspace_max=(0.4, 1.0, 1.0)))
    assert workspace(SafetyParams(workspace_min=(-5.0,) * 3, workspace_max=(5.0,) * 3)) is None


def test_a_spike_of_force_stops_any_motion_and_latches(
    make_executor: Callable, make_arm: Callable
) -> None:
    """A force beyond the envelope is nothing to go on from without somebody having looked."""
    arm = make_arm()
    origin = arm.tip.copy()
    arm.force = lambda tip: 60.0 * FORWARD * (np.linalg.norm(tip - origin) > 0.05)
    executor = make_executor(force_limit=40.0)
    result = arm.run(executor, approach())
    assert result.reason is MotionReason.FORCE_LIMIT
    assert "60 N" in result.message
    assert not arm.state.velocity.any()
    with pytest.raises(MotionRejectedError, match="motion/clear_stop"):
        executor.start(approach(), arm.observe())
    arm.force = lambda tip: np.zeros(3)
    assert "60 N" in executor.clear_stop(arm.time)
    assert arm.run(executor, RETREAT).reason is MotionReason.REACHED


def test_a_halt_brakes_and_stays_until_it_is_released(
    make_executor: Callable, make_arm: Callable, limits: JointLimits
) -> None:
    executor = make_executor()
    arm = make_arm()
    executor.start(approach(), arm.observe())
    for _ in range(30):
        update = executor.tick(arm.observe())
        if update.trajectory is not None:
            arm.take(update.trajectory)
        arm.advance()
    assert arm.state.velocity.any()
    assert executor.halt("somebody came near", arm.time)
    result = arm.finish(executor)
    assert result.reason is MotionReason.STOPPED
    assert "somebody came near" in result.message
    assert not arm.state.velocity.any()
    for _, _, trajectory in arm.issued:
        assert limits.violation(trajectory) is None
    with pytest.raises(MotionRejectedError, match="somebody came near"):
        executor.start(RETREAT, arm.observe())
    assert executor.clear_stop(arm.time) == "somebody came near"
    assert executor.clear_stop(arm.time) == ""
    assert arm.run(executor, RETREAT).reason is MotionReason.REACHED


def test_a_goal_that_was_planned_before_the_halt_does_not_begin_after_it(
    make_executor: Callable, make_arm: Callable
) -> None:
    executor, arm = make_executor(), make_arm()
    prepared = executor.prepare(approach(), arm.observe())
    executor.halt("stop", arm.time)
    with pytest.raises(MotionRejectedError, match="latched"):
        executor.begin(prepared, arm.observe())


def test_frozen_joint_states_stop_the_motion_and_name_the_controller(
    make_executor: Callable, make_arm: Callable
) -> None:
    """JointTrajectoryController rejects with only a log line: the arm then just stands."""
    arm = make_arm()
    arm.follows = False
    result = arm.run(make_executor(lag_limit=0.15), approach(x=0.5, y=-0.3))
    assert result.reason is MotionReason.LAGGING
    assert "rejected the trajectory" in result.message
    assert result.duration < 3.0
    assert not arm.issued[-1][2].velocities[-1].any()


def drive(executor: MotionExecutor, arm: Any, seconds: float) -> None:
    """Tick for a while; the motion must not end meanwhile."""
    for _ in range(int(seconds / arm.period)):
        update = executor.tick(arm.observe())
        if update.trajectory is not None:
            arm.take(update.trajectory)
        assert update.result is None
        arm.advance()


def test_an_arm_that_was_held_is_noticed_at_once_and_the_next_motion_starts_where_it_stands(
    make_executor: Callable, make_arm: Callable
) -> None:
    """The incident: a late heartbeat held the arm, and the next trajectory began 1 rad ahead."""
    executor, arm = make_executor(lag_limit=0.05), make_arm()
    executor.start(approach(x=0.5, y=-0.3), arm.observe())
    drive(executor, arm, 0.6)
    assert np.abs(arm.state.velocity).max() > 0.2
    arm.follows = False
    arm.state = type(arm.state).at_rest(arm.state.position)
    held = arm.time
    result = arm.finish(executor)
    assert result.reason is MotionReason.LAGGING
    stop = next(since for since, _, _ in arm.issued if since > held)
    assert stop - held < 0.5
    stands, before = arm.state.position.copy(), len(arm.issued)
    arm.follows = True
    arm.issued.clear()
    assert arm.run(executor, RETREAT).reason is MotionReason.REACHED
    first = arm.issued[0][2]
    assert before > 0
    assert np.abs(first.positions[0] - stands).max() < 0.01


@pytest.mark.parametrize("late", [0.0, 0.1, 0.2])
def test_an_arm_that_follows_late_is_no_arm_that_does_not_follow(
    make_executor: Callable, make_arm: Callable, late: float
) -> None:
    """At a radian a second, a tenth of a second of delay is a tenth of a radian."""
    executor, arm = make_executor(lag_limit=0.05), make_arm()
    states: list[Any] = []
    advance = arm.advance

    def advance_late() -> None:
        advance()
        states.append(arm.state)

    observe = arm.observe

    def observe_late() -> Any:
        seen = observe()
        ago = round(late / arm.period)
        past = states[-1 - ago] if ago < len(states) else (states or [arm.state])[0]
        return replace(seen, positions=past.position.copy(), velocities=past.velocity.copy())

    arm.advance, arm.observe = advance_late, observe_late
    result = arm.run(executor, approach(x=0.5, y=-0.3))
    assert result.reason is MotionReason.REACHED, result.message
    if late:
        assert result.max_lag > 0.05


def test_a_dry_run_shows_and_moves_nothing(
    make_executor: Callable, make_arm: Callable, facing: np.ndarray
) -> None:
    for start, goal in ((None, approach()), (facing, step(-FORWARD)), (None, RETREAT)):
        arm = make_arm() if start is None else make_arm(start)
        arm.vacuum = lambda tip, holds=goal.kind is MotionKind.FLOW_STEP: holds
        executor = make_executor(dry_run=True)
        executor.start(goal, arm.observe())
        shown = None
        for _ in range(5):
            update = executor.tick(arm.observe())
            assert update.trajectory is None
            shown = update.shown or shown
            if update.result is not None:
                break
        assert update.result is not None
        assert update.result.reason is MotionReason.STOPPED
        assert "dry run" in update.result.message
        assert shown is not None
        assert not executor.busy


def test_every_commanded_motion_is_in_the_audit_log(
    make_executor: Callable, make_arm: Callable, tmp_path: Path
) -> None:
    log = AuditLog(tmp_path / "deep" / "audit.jsonl", 10_000)
    executor = make_executor(audit=log)
    arm = make_arm()
    arm.run(executor, approach())
    executor.halt("enough", arm.time)
    executor.clear_stop(arm.time)
    arm.run(executor, RETREAT)
    log.close()
    lines = (tmp_path / "deep" / "audit.jsonl").read_text().splitlines()
    entries = [json.loads(line) for line in lines]
    sent = [entry for entry in entries if entry["event"] == "trajectory"]
    assert len(sent) == len(arm.issued)
    for entry, (time, _, trajectory) in zip(sent, arm.issued, strict=True):
        assert entry["time"] == pytest.approx(time, abs=1e-5)
        np.testing.assert_allclose(entry["last"], trajectory.positions[-1], atol=1e-5)
    events = [entry["event"] for entry in entries if entry["event"] != "trajectory"]
    assert events == ["goal", "result", "halt", "clear_stop", "goal", "result"]


def test_the_audit_log_rotates_and_a_bad_place_is_an_error(tmp_path: Path) -> None:
    log = AuditLog(tmp_path / "audit.jsonl", 10_000)
    for k in range(400):
        log.write("goal", float(k), {"filler": "x" * 60})
    log.close()
    files = sorted(tmp_path.iterdir())
    assert len(files) > 2
    assert all(file.stat().st_size <= 10_000 for file in files)
    kept = [json.loads(line)["time"] for file in files for line in file.read_text().splitlines()]
    assert sorted(kept) == [float(k) for k in range(400)]
    (tmp_path / "file").write_text("")
    with pytest.raises(ParameterError, match="audit log cannot be written"):
        AuditLog(tmp_path / "file" / "audit.jsonl", 10_000)
