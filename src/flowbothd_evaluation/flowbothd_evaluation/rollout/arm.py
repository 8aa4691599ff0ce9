"""The arm in its stepped world, with the same cores that the nodes run."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

from flowbothd_common.errors import MotionRejectedError
from flowbothd_common.motion import MotionGoal, MotionKind, MotionReason, MotionResult
from flowbothd_common.parameters import build
from flowbothd_common.types import Cloud, SuctionPhase
from flowbothd_evaluation.rollout.driver import PolicyDriver
from flowbothd_evaluation.run_record.record import MotionEntry, RunRecord, StateSample
from flowbothd_perception.params import PipelineParams
from flowbothd_perception.pipeline import PerceptionPipeline
from flowbothd_policy.events import CloudArrived, Event, MotionFinished, SuctionChanged
from flowbothd_policy.params import PolicyParams
from flowbothd_policy.predictor import FlowPredictor
from franka_suction_driver.arm.description import compose_urdf
from franka_suction_driver.arm.kinematics import make_kinematics
from franka_suction_driver.execution.executor import MotionExecutor
from franka_suction_driver.params import MotionParams
from franka_suction_driver.simulated import sim_motion_params
from franka_suction_driver.suction.suction import SuctionMachine
from franka_suction_driver.suction_params import SuctionParams
from sim_bridge.camera import DepthCamera
from sim_bridge.depth_noise import DepthNoise
from sim_bridge.objects.registry import load_object
from sim_bridge.oracle import GroundTruthFlow, OracleParams, OraclePredictor
from sim_bridge.scenes import Scene
from sim_bridge.world import ArmWorld

_log = logging.getLogger(__name__)

TICKS = 4
"""World ticks (240 Hz) between two ticks of motion and suction: 60 Hz, as in the node."""


class ArmPolicyWorld:
    """ArmWorld, camera, perception, motion and suction as the policy driver wants them.

    Args:
        world: Reset.
        camera: Sees the world's parts.
        perception: From points in the camera frame to the object cloud.
        executor: Moves the arm.
        seed: Of the cloud sampling.
        record: Gets the motion results.
    """

    def __init__(
        self,
        world: ArmWorld,
        camera: DepthCamera,
        perception: PerceptionPipeline,
        executor: MotionExecutor,
        seed: int,
        record: RunRecord,
    ) -> None:
        self._world, self._camera, self._perception = world, camera, perception
        self._executor, self._seed, self._record = executor, seed, record
        self._suction = SuctionMachine(SuctionParams(), world.time)
        self._phase = SuctionPhase.OFF
        self._looks = 0

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._world.time

    def tick(self) -> list[Event]:
        """Advance by one control period."""
        self._world.step(TICKS)
        update = self._executor.tick(self._world.observation())
        events: list[Event] = []
        if update.trajectory is not None:
            refusal = self._world.command_trajectory(update.trajectory)
            if refusal:
                # As on the topic: nobody answers, motion has to see that the arm does not follow.
                _log.warning("trajectory refused: %s", refusal)
        if update.result is not None:
            self._record.motions.append(MotionEntry.of(update.result, self.time))
            events.append(MotionFinished(update.result))
        return [*self._suction_events(), *events]

    def observe(self) -> CloudArrived:
        """Take a picture and turn it into the object cloud."""
        return CloudArrived(self._look(), self.time)

    def _look(self) -> Cloud:
        """The object cloud now, which also becomes the obstacle."""
        image = self._camera.render(self._world.part_poses())
        # Organised, as from a camera; where nothing was measured the points are (0, 0, 0).
        points = self._camera.intrinsics.directions() * image.depth[..., None]
        self._looks += 1
        positions, _ = self._world.joint_state()
        result = self._perception.process(
            points, self._camera.T_base_camera, positions, seed=(self._seed, self._looks)
        )
        self._executor.set_obstacles(result.points, self._camera.T_base_camera[:3, 3])
        return result.points

    def move(self, goal: MotionGoal) -> list[Event]:
        """Begin a motion; planning takes no simulated time."""
        if goal.kind in (MotionKind.APPROACH, MotionKind.RETREAT):
            # As in the nodes, where clouds keep coming: the part has moved since the last look.
            self._look()
        try:
            self._executor.start(goal, self._world.observation())
        except MotionRejectedError as error:
            tip = self._world.tip_pose()
            result = MotionResult(goal.kind, MotionReason.REJECTED, str(error), 0.0, tip, tip)
            return [MotionFinished(result)]
        return []

    def stop(self) -> None:
        """Bring the running motion to rest."""
        self._executor.stop()

    def set_suction(self, vacuum: float) -> list[Event]:
        """Command the pump."""
        self._world.command_suction(vacuum)
        self._suction.command(vacuum, self.time)
        return self._suction_events()

    def state(self) -> StateSample:
        """The world for the record."""
        positions, _ = self._world.joint_state()
        joints = self._world.object_positions()
        return StateSample(self.time, positions, joints, self._world.open_ratio)

    def truth(self, points: Cloud) -> GroundTruthFlow:
        """Return the true flow of a cloud; for oracles."""
        return self._world.ground_truth_flow(points)

    def _suction_events(self) -> list[Event]:
        self._suction.measure(self._world.suction(), self.time)
        status = self._suction.status(self.time)
        if status.phase is self._phase:
            return []
        self._phase = status.phase
        return [SuctionChanged(status.phase, status.message)]


def arm_rollout(
    scene: Scene,
    *,
    seed: int,
    mode: str = "",
    predictor: str | FlowPredictor = "oracle",
    policy: Mapping[str, Any] | None = None,
    motion: MotionParams | None = None,
    disturb: Callable[[ArmWorld], ArmWorld] | None = None,
) -> tuple[RunRecord, dict[str, float]]:
    """One run from home pose and closed object to the policy's own outcome.

    Args:
        scene: Object, poses, camera.
        seed: Mode (if none is given), proportions, noise, sampling.
        mode: Of an object with modes.
        predictor: oracle, ambiguous, or anything that predicts.
        policy: Parameters of the policy by dotted name, on top of the scene's.
        motion: Parameters of the motion core; those of the simulation if omitted.
        disturb: Puts something between world and cores, as a fault; for tests.

    Returns:
        The record, and the largest force [N] of every contact of the arm that was not the cup's,
        by "robot link - thing".
    """
    model = load_object(scene.object, mode=mode or None, seed=seed)
    urdf = compose_urdf()
    params = build(PolicyParams, {**scene.policy, **(policy or {}), "seed": seed})
    motion = motion or sim_motion_params()
    record = RunRecord(scene.name, model.mode, seed, str(predictor))
    with ArmWorld(urdf, model, scene.T_base_object) as world:
        camera = DepthCamera(world.parts(), scene.T_base_camera, noise=DepthNoise(), seed=seed)
        executor = MotionExecutor(make_kinematics(motion, urdf), motion, seed)
        perception = PerceptionPipeline(PipelineParams(), urdf)
        driven = world if disturb is None else disturb(world)
        adapter = ArmPolicyWorld(driven, camera, perception, executor, seed, record)
        if isinstance(predictor, str):
            predictor = OraclePredictor(adapter.truth, OracleParams(predictor))
        record.predictor = predictor.model_id
        PolicyDriver(adapter, predictor, params, record).run()
        contacts = {
            f"{a} - {b}": round(force, 1) for (a, b), force in world.worst_contacts().items()
        }
    return record, contacts
