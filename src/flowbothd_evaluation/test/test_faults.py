"""Faults in whole stepped runs: the arm stops, says why, and the policy copes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flowbothd_common.motion import JointTrajectory, MotionGoal, RobotObservation
from flowbothd_common.types import SuctionReading
from flowbothd_evaluation.rollout.arm import ArmPolicyWorld, arm_rollout
from flowbothd_evaluation.run_record.record import RunRecord
from flowbothd_policy.events import Event
from franka_suction_driver.params import MotionParams
from franka_suction_driver.simulated import sim_motion_params
from sim_bridge.scenes import scene_for

pytestmark = pytest.mark.long

PULL = 0.02
"""How far the part has moved when what happens mid-pull happens [rad]."""


class Disturbed:
    """ArmWorld with a fault between it and everything that measures or commands it.

    Attributes:
        happened_at: When [s]; None before.
        sent: Trajectories since the start.
        fastest: The arm's fastest joint since it happened, as it truly was [rad/s].
    """

    def __init__(self, world: Any) -> None:
        self._world = world
        self.happened_at: float | None = None
        self.sent = 0
        self.fastest = 0.0

    def step(self, count: int) -> None:
        for _ in range(count):
            self._world.step(1)
            if self.happened:
                speeds = np.abs(self._world.joint_state()[1])
                self.fastest = max(self.fastest, float(speeds.max()))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._world, name)

    @property
    def happened(self) -> bool:
        return self.happened_at is not None

    def happen(self) -> None:
        if not self.happened:
            self.happened_at = self._world.time

    def pulling(self) -> bool:
        """The cup holds and the part has begun to move."""
        opened = np.abs(list(self._world.object_positions().values())).max()
        return bool(self._world.suction().part_present and opened > PULL)

    def observation(self) -> RobotObservation:
        return self._world.observation()

    def suction(self) -> SuctionReading:
        return self._world.suction()

    def command_trajectory(self, trajectory: JointTrajectory, stamp: float = 0.0) -> str:
        self.sent += 1
        return self._world.command_trajectory(trajectory, stamp)


class LosesVacuum(Disturbed):
    """The seal opens in the middle of the first pull."""

    def observation(self) -> RobotObservation:
        if not self.happened and self.pulling():
            self.happen()
            self._world.cup.command(0.0)
            self._world.cup.command(60000.0)
        return self._seen(self._world.observation())

    def _seen(self, seen: RobotObservation) -> RobotObservation:
        return replace(seen, vacuum=False, vacuum_lost=True) if self._lost() else seen

    def suction(self) -> SuctionReading:
        reading = self._world.suction()
        return SuctionReading(0.0, False, True) if self._lost() else reading

    def command_suction(self, vacuum: float) -> None:
        # A new cycle begins when the pump is switched off.
        if vacuum == 0 and self.happened:
            self.happened_at = -1.0
        self._world.command_suction(vacuum)

    def _lost(self) -> bool:
        return self.happened_at is not None and self.happened_at >= 0


class FreezesJoints(Disturbed):
    """Joint states go on coming, but are those of a moment during the approach."""

    frozen: RobotObservation | None = None

    def observation(self) -> RobotObservation:
        seen = self._world.observation()
        if self.frozen is None and np.abs(seen.velocities).max() > 0.3:
            self.happen()
            self.frozen = seen
        if self.frozen is None:
            return seen
        return replace(seen, positions=self.frozen.positions, velocities=self.frozen.velocities)


class SpikesForce(Disturbed):
    """Two hundred newtons for a tenth of a second, while the arm approaches."""

    def observation(self) -> RobotObservation:
        seen = self._world.observation()
        if not self.happened and np.abs(seen.velocities).max() > 0.3:
            self.happen()
        if self.happened_at is None or self._world.time > self.happened_at + 0.1:
            return seen
        return replace(seen, wrench=np.array([200.0, 0, 0, 0, 0, 0]))


class RejectsTrajectories(Disturbed):
    """A controller that takes no trajectory and says so only in its own log."""

    def command_trajectory(self, trajectory: JointTrajectory, stamp: float = 0.0) -> str:
        self.happen()
        self.sent += 1
        return ""


class MissesBeats(Disturbed):
    """The heartbeat is late in the middle of a pull: the arm is held, and refuses meanwhile."""

    gap = 0.03

    def step(self, count: int) -> None:
        if not self.happened and self.pulling():
            self.happen()
            self._world.hold()
        super().step(count)

    def command_trajectory(self, trajectory: JointTrajectory, stamp: float = 0.0) -> str:
        if self.happened_at is not None and self._world.time < self.happened_at + self.gap:
            return "motion/heartbeat is silent"
        return super().command_trajectory(trajectory, stamp)


class MissesManyBeats(MissesBeats):
    """The same, for longer than the step takes."""

    gap = 2.0


class IsPreempted(Disturbed):
    """Somebody else holds the arm in the middle of the first approach."""

    def observation(self) -> RobotObservation:
        seen = self._world.observation()
        if not self.happened and np.abs(seen.velocities).max() > 0.3:
            self.happen()
            self._world.hold()
        return seen


@pytest.fixture
def run_with() -> Callable[..., tuple[RunRecord, Disturbed]]:
    """A whole run of the door with a fault; the arm must rest when it is over."""

    def run(fault: type[Disturbed], **safety: Any) -> tuple[RunRecord, Disturbed]:
        made: list[Disturbed] = []
        rest: list[float] = []
        pump: list[tuple[float, bool]] = []

        def disturb(world: Any) -> Any:
            made.append(fault(world))
            close = world.close

            def closing() -> None:
                rest.append(float(np.abs(world.joint_state()[1]).max()))
                # Whatever is left of the vacuum is vented: what counts is what the pump is told.
                world.step(240)
                reading = world.suction()
                pump.append((reading.vacuum, reading.part_present))
                close()

            world.close = closing
            return made[0]

        base = sim_motion_params()
        motion: MotionParams = replace(base, safety=replace(base.safety, **safety))
        scene = scene_for("custom_door")
        record, _ = arm_rollout(scene, seed=0, mode="pull_left", motion=motion, disturb=disturb)
        assert made[0].happened, "the fault did not come about"
        assert rest, "the world was not closed"
        assert max(rest) < 0.05, "the arm still moves at the end"
        assert pump[0][0] < 1000.0, "the pump still runs at the end"
        assert not pump[0][1], "the cup still holds the part at the end"
        return record, made[0]

    return run


def reasons(record: RunRecord, motion: str) -> list[str]:
    return [entry["reason"] for entry in record.motions if entry["motion"] == motion]


def test_a_part_that_comes_off_is_grasped_again(run_with: Callable) -> None:
    record, _ = run_with(LosesVacuum)
    assert "suction_lost" in reasons(record, "flow_step")
    assert len(reasons(record, "approach")) > 1
    assert record.summary()["outcome"] in ("opened", "gave_up", "not_opened")


def test_frozen_joint_states_end_the_run(run_with: Callable) -> None:
    record, _ = run_with(FreezesJoints, lag_limit=0.15)
    assert reasons(record, "approach")[0] == "lagging"
    assert record.summary()["outcome"] != "opened"
    assert record.summary()["reason"]


def test_a_spike_of_force_stops_and_latches_and_the_policy_gives_up(run_with: Callable) -> None:
    record, _ = run_with(SpikesForce, force_limit=40.0)
    assert reasons(record, "approach")[0] == "force_limit"
    assert set(reasons(record, "retreat") + reasons(record, "approach")[1:]) <= {"rejected"}
    assert "motion/clear_stop" in str([entry["message"] for entry in record.motions])
    assert record.summary()["outcome"] != "opened"


def test_a_controller_that_rejects_in_silence_is_noticed(run_with: Callable) -> None:
    record, world = run_with(RejectsTrajectories, lag_limit=0.15)
    assert reasons(record, "approach")[0] == "lagging"
    first = next(entry for entry in record.motions if entry["motion"] == "approach")
    assert "rejected the trajectory" in first["message"]
    assert world.sent > 0
    assert record.summary()["outcome"] != "opened"


def test_a_goal_inside_the_table_moves_nothing_and_the_policy_goes_on(
    run_with: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A camera that is calibrated too low sees the part inside the table; then it is put right."""
    move = ArmPolicyWorld.move
    sunk: list[MotionGoal] = []

    def sinking(self: ArmPolicyWorld, goal: MotionGoal) -> list[Event]:
        if goal.contact is not None and len(sunk) < 2:
            goal = replace(goal, contact=goal.contact * [1, 1, 0] - [0, 0, 0.15])
            sunk.append(goal)
            self._world.happen()
        return move(self, goal)

    monkeypatch.setattr(ArmPolicyWorld, "move", sinking)
    record, world = run_with(Disturbed)
    first = [entry for entry in record.motions if entry["motion"] == "approach"][:2]
    assert {entry["reason"] for entry in first} <= {"unreachable", "collision"}
    assert all(entry["reached_fraction"] == 0 and entry["message"] for entry in first)
    assert not any("table" in pair for pair in world.worst_contacts())
    assert record.summary()["outcome"] == "opened"


@pytest.mark.parametrize(("fault", "costs"), [(MissesBeats, False), (MissesManyBeats, True)])
def test_a_late_heartbeat_costs_a_step_at_most_and_not_the_run(
    run_with: Callable, fault: type[Disturbed], costs: bool
) -> None:
    """The incident: the arm was held mid-pull, and snapped after its reference at 23 rad/s."""
    record, world = run_with(fault)
    assert ("lagging" in reasons(record, "flow_step")) == costs
    assert record.summary()["outcome"] == "opened"
    assert record.summary()["grasps"] == 1, "the part was held all the time"
    assert world.fastest < 2.2


def test_a_preempted_trajectory_ends_and_the_policy_goes_on(run_with: Callable) -> None:
    record, world = run_with(IsPreempted, lag_limit=0.15)
    assert reasons(record, "approach")[0] == "lagging"
    assert len(record.motions) > 1
    assert record.summary()["outcome"] == "opened"
    assert world.fastest < 2.2
