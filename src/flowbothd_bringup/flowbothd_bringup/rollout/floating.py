"""The floating suction gripper of the paper's evaluation, driven by the robot's policy."""

from __future__ import annotations

import numpy as np

from flowbothd_bringup.record import RunRecord, StateSample
from flowbothd_bringup.rollout.driver import PolicyDriver
from flowbothd_common.motion import MotionGoal
from flowbothd_common.types import Cloud, SuctionPhase
from flowbothd_policy.events import CloudArrived, Event, MotionFinished, SuctionChanged
from flowbothd_policy.oracle import OracleParams, OraclePredictor, Truth
from flowbothd_policy.params import OpeningParams, PolicyParams
from flowbothd_policy.predictor import FlowPredictor
from sim_bridge.floating import FloatingWorld
from sim_bridge.objects.model import ObjectModel

POINTS = 1200
SUCCESS = 0.9

FLOATING_POLICY = PolicyParams(
    # The reference pulls 0.4 m/s for 100 ticks of 1/240 s.
    step_distance=0.4 * 100 / 240,
    # The ball is held rigidly, and the evaluation ends the run, not the tool's path.
    compliance=0.0,
    # Less is jitter of a ball that pulls at a part which cannot follow.
    consistency_min_motion=0.005,
    opening=OpeningParams(target_angle=100.0, target_distance=1000.0, limit_last_step=False),
)
"""The policy as the paper's evaluation runs it: 30 steps, ended when the joint is open."""


class FloatingPolicyWorld:
    """FloatingWorld as the policy driver wants it: every motion is over at once.

    Args:
        world: Reset.
        target_mask: Show the policy only points of the target link, as the released code does.
    """

    def __init__(self, world: FloatingWorld, *, target_mask: bool) -> None:
        self._world, self._target_mask = world, target_mask
        # A gripper that moves in no time would hand out clouds with the same stamp.
        self._looks = 0
        self._phase = SuctionPhase.OFF

    @property
    def time(self) -> float:
        """Simulated time, with a little for every look [s]."""
        return self._world.time + 1e-3 * self._looks

    def tick(self) -> list[Event]:
        """Let a little time pass in which nothing happens."""
        self._looks += 1
        return []

    def observe(self) -> CloudArrived:
        """The whole object, or the target link of it."""
        self._looks += 1
        seen = self._world.observe(POINTS)
        points = seen.points
        if self._target_mask:
            link = self._world.model.target.child
            points = points[np.array([name == link for name in seen.links])]
        return CloudArrived(points, self.time)

    def move(self, goal: MotionGoal) -> list[Event]:
        """Do the motion."""
        result = self._world.execute(goal)
        return [MotionFinished(result), *self._suction_events()]

    def stop(self) -> None:
        """Nothing is under way between two motions."""

    def set_suction(self, vacuum: float) -> list[Event]:
        """Switch the suction."""
        self._world.command_suction(vacuum)
        return self._suction_events()

    def state(self) -> StateSample:
        """The world for the record."""
        return StateSample(
            self.time, np.empty(0), self._world.object_positions(), self._world.open_ratio
        )

    def truth(self, points: Cloud, *, target_only: bool) -> Truth:
        """What an oracle may know."""
        truth = self._world.ground_truth_flow(points, target_only=target_only)
        return Truth(truth.flows, truth.modes, truth.open_ratio)

    def _suction_events(self) -> list[Event]:
        reading = self._world.suction()
        phase = SuctionPhase.OFF
        if reading.part_present:
            phase = SuctionPhase.HOLDING
        elif reading.part_detached:
            phase = SuctionPhase.LOST
        if phase is self._phase:
            return []
        self._phase = phase
        return [SuctionChanged(phase)]


def floating_rollout(
    model: ObjectModel,
    params: PolicyParams,
    *,
    predictor: FlowPredictor | None = None,
    oracle: OracleParams | None = None,
    target_mask: bool = True,
) -> RunRecord:
    """One run from closed, ended as soon as the target joint is more than 0.9 open.

    Args:
        model: Object with its target joint.
        params: Of the policy; its seed also draws the cloud's points.
        predictor: Samples flow fields; None = an oracle.
        oracle: How the oracle errs; by default the plain truth of the target joint.
        target_mask: Only points of the target link may be seen and grasped.
    """
    with FloatingWorld(model, params.seed) as world:
        adapter = FloatingPolicyWorld(world, target_mask=target_mask)
        if predictor is None:
            predictor = OraclePredictor(
                lambda points: adapter.truth(points, target_only=True), oracle
            )
        record = RunRecord(model.name, model.mode, params.seed, predictor.model_id)
        driver = PolicyDriver(adapter, predictor, params, record, stop_at=SUCCESS)
        return driver.run()
