"""The floating suction gripper of the paper's evaluation, driven by the robot's policy."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.motion import MotionGoal
from flowbothd_common.types import Cloud, History, SuctionPhase, max_normalised
from flowbothd_evaluation.rollout.driver import PolicyDriver
from flowbothd_evaluation.run_record.record import RunRecord, StateSample
from flowbothd_policy.events import CloudArrived, Event, MotionFinished, SuctionChanged
from flowbothd_policy.params import GraspParams, OpeningParams, PolicyParams
from flowbothd_policy.predictor import FlowPredictor
from sim_bridge.floating import FloatingWorld
from sim_bridge.objects.model import ObjectModel
from sim_bridge.oracle import GroundTruthFlow, OracleParams, OraclePredictor

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
    # There is no wrist behind the ball.
    grasp=GraspParams(table_clearance=0.0),
)
"""The policy as the paper's evaluation runs it: 30 steps, ended when the joint is open."""


class FloatingPolicyWorld:
    """FloatingWorld as the policy driver wants it: every motion is over at once.

    Args:
        world: Reset.
        counting: Joints of which any may be the one that opens; None = the target joint.
    """

    def __init__(self, world: FloatingWorld, counting: Collection[str] | None = None) -> None:
        self._world = world
        self._counting = (world.model.target_joint,) if counting is None else tuple(counting)
        self.on_target = np.zeros(0, dtype=bool)
        """(N,) whether a point of the last cloud lies on the target link; not for the policy."""
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
        """What the camera sees of the object."""
        self._looks += 1
        seen = self._world.observe(POINTS)
        link = self._world.model.target.child
        self.on_target = np.array([name == link for name in seen.links], dtype=bool)
        return CloudArrived(seen.points, self.time)

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
        return StateSample(self.time, np.empty(0), self._world.object_positions(), self.open_ratio)

    def furthest(self) -> str:
        """The joint that counts; of several, the one that is open furthest."""
        ratios = self._world.open_ratios()
        return max(self._counting, key=lambda name: ratios[name])

    @property
    def open_ratio(self) -> float:
        """Of that joint."""
        return self._world.open_ratios()[self.furthest()]

    def truth(self, points: Cloud, *, target_only: bool) -> GroundTruthFlow:
        """Return the true flow of a cloud; for oracles."""
        return self._world.ground_truth_flow(points, target_only=target_only)

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


class TargetOnly:
    """A predictor whose flow counts on the target link alone, as in the released code.

    It sees the whole cloud; what it predicts for other links is not acted upon.

    Args:
        predictor: To be restricted.
        world: Knows which points lie on the target link.
    """

    def __init__(self, predictor: FlowPredictor, world: FloatingPolicyWorld) -> None:
        self._predictor, self._world = predictor, world
        self.model_id = predictor.model_id

    def sample(
        self,
        points: Cloud,
        history: History | None = None,
        samples: int = 1,
        steps: int | None = None,
        sampler: str | None = None,
        seed: int | None = None,
    ) -> NDArray[np.float32]:
        """(samples, N, 3) flows, zero off the target link."""
        flows = self._predictor.sample(points, history, samples, steps, sampler, seed)
        return max_normalised(flows * self._world.on_target[None, :, None])


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
        target_mask: Only points of the target link may be grasped.
    """
    with FloatingWorld(model, params.seed) as world:
        adapter = FloatingPolicyWorld(world)
        if predictor is None:
            predictor = OraclePredictor(
                lambda points: adapter.truth(points, target_only=True), oracle
            )
        if target_mask:
            predictor = TargetOnly(predictor, adapter)
        record = RunRecord(model.name, model.mode, params.seed, predictor.model_id)
        driver = PolicyDriver(adapter, predictor, params, record, stop_at=SUCCESS)
        return driver.run()
