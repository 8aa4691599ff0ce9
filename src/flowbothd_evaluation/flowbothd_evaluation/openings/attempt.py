"""One run of an opening: from the home pose, with the true flow, one grasp, and home again."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from flowbothd_common.motion import (
    MotionGoal,
    MotionKind,
    MotionReason,
    MotionResult,
    RobotObservation,
)
from flowbothd_common.transforms import look_at
from flowbothd_common.types import Array, SuctionPhase
from flowbothd_evaluation.openings.contacts import TouchLog
from flowbothd_evaluation.openings.part import TruePart
from flowbothd_evaluation.openings.task import Opening
from flowbothd_evaluation.openings.views import camera_view
from flowbothd_evaluation.rollout.arm import ArmPolicyWorld
from flowbothd_evaluation.run_record.record import RunRecord
from flowbothd_perception.params import PipelineParams
from flowbothd_perception.pipeline import PerceptionPipeline
from flowbothd_policy.events import Event, MotionFinished, SuctionChanged
from flowbothd_policy.params import PolicyParams
from franka_suction_driver.arm.description import compose_urdf
from franka_suction_driver.arm.kinematics import make_kinematics
from franka_suction_driver.execution.executor import MotionExecutor
from franka_suction_driver.params import MotionParams
from franka_suction_driver.simulated import sim_motion_params
from sim_bridge.camera import DepthCamera
from sim_bridge.depth_noise import DepthNoise
from sim_bridge.world import ArmWorld

NOISE = 0.005
"""Standard deviation of the grasp point on the part's face, in each direction [m]."""

_STEP = 0.05
_MOST_TURN = 0.3
# A pushing tool tilts as far as the cup holds: the part must not turn much before it follows.
_MOST_TURN_PUSHING = 0.15
_LEAST_STEP = 0.004
_IDLE = 0.05
_MOST_STEPS = 40
_LONGEST_MOTION = 120.0
_LONGEST_RELEASE = 5.0

Watcher = Callable[[str, ArmWorld], None]
"""Is told the name of every moment worth a picture."""


@dataclass
class Course:
    """What is measured of a run as it goes.

    Attributes:
        phase: approach, probe, open, release or leave.
        reached: Joint value when the cup last held [rad or m].
        breaks: Why the part came off, each time.
        peak_force: Largest force on the tool, by phase [N].
        peak_torque: The same of torque [Nm].
        reasons: How every motion ended, in order.
        planning: Thread time of planning by kind of motion [s].
    """

    phase: str = "approach"
    reached: float = 0.0
    breaks: list[str] = field(default_factory=list)
    peak_force: dict[str, float] = field(default_factory=dict)
    peak_torque: dict[str, float] = field(default_factory=dict)
    reasons: list[str] = field(default_factory=list)
    planning: dict[str, list[float]] = field(default_factory=dict)

    def feel(self, wrench: Array) -> None:
        """Keep the peaks of the present phase."""
        for peaks, part in ((self.peak_force, wrench[:3]), (self.peak_torque, wrench[3:])):
            peaks[self.phase] = max(peaks.get(self.phase, 0.0), float(np.linalg.norm(part)))


class _TimedExecutor(MotionExecutor):
    """Writes down what planning takes."""

    planning: dict[str, list[float]]

    def start(self, goal: MotionGoal, observation: RobotObservation) -> None:
        """Plan and begin, on the clock."""
        began = time.thread_time()
        try:
            super().start(goal, observation)
        finally:
            self.planning.setdefault(goal.kind.value, []).append(time.thread_time() - began)


class Attempt:
    """Approach, probe, open, release, leave; ground truth tells flow and joint value.

    Args:
        opening: The task.
        part: Its part.
        contact: (3,) where to take hold, in base [m].
        world: Reset, the arm at home.
        driven: The same world with camera and cores.
        log: Of touches.
        course: Is filled.
        watch: Told of moments.
    """

    def __init__(
        self,
        opening: Opening,
        part: TruePart,
        contact: Array,
        world: ArmWorld,
        driven: ArmPolicyWorld,
        log: TouchLog,
        course: Course,
        watch: Watcher,
    ) -> None:
        self._opening, self._part, self._contact = opening, part, contact
        self._world, self._driven = world, driven
        self._log, self._course, self._watch = log, course, watch
        self._vacuum = PolicyParams().vacuum
        self._held = False

    def run(self) -> None:
        """From home to home, as far as it goes."""
        self._watch("home", self._world)
        flow = self._part.flow(self._contact, self._value)
        joint = self._part.joint_in_base
        goal = MotionGoal(MotionKind.APPROACH, self._contact, flow, joint=joint)
        if self._move("approach", goal).reason is MotionReason.REACHED:
            self._take(self._driven.set_suction(self._vacuum))
            self._watch("standoff", self._world)
            towards = -flow if float(self._world.tip_pose()[:3, 2] @ flow) < 0 else flow
            self._move("probe", MotionGoal(MotionKind.PROBE, direction=towards))
            self._watch("held" if self._held else "not held", self._world)
            if self._held:
                self._open()
            self._release()
        self._move("leave", MotionGoal(MotionKind.RETREAT))
        self._watch("home again", self._world)

    @property
    def _value(self) -> float:
        return self._world.object_positions()[self._world.model.target_joint]

    def _open(self) -> None:
        idle = 0
        for step in range(1, _MOST_STEPS + 1):
            tip = self._world.tip_pose()[:3, 3]
            before, left = self._value, self._opening.goal - self._value
            flow, joint = self._part.flow(tip, before), self._part.joint_in_base
            if left <= 0 or not self._held or idle > 1:
                break
            distance = self._distance(tip, left)
            self._move("open", MotionGoal(MotionKind.FLOW_STEP, None, flow, distance, joint))
            moved = self._part.way(tip, self._value - before)
            idle = idle + 1 if moved < _IDLE * distance else 0
            self._watch(f"step {step}", self._world)

    def _distance(self, tip: Array, left: float) -> float:
        """Length of the next step, with an opening of `left` [rad or m] to go [m]."""
        way, radius = self._part.way(tip, left), self._part.radius(tip)
        if not self._opening.front:
            return max(_LEAST_STEP, min(_STEP, _MOST_TURN * radius, way))
        # These are hardly longer than the shortest that can be made: equal ones end at the goal.
        count = max(1, round(way / max(_LEAST_STEP, _MOST_TURN_PUSHING * radius)))
        return max(_LEAST_STEP, way / count)

    def _release(self) -> None:
        self._course.phase = "release"
        self._take(self._driven.set_suction(0.0))
        ends = self._world.time + _LONGEST_RELEASE
        while self._world.suction().vacuum > 1000.0 and self._world.time < ends:
            self._tick()

    def _move(self, phase: str, goal: MotionGoal) -> MotionResult:
        self._course.phase = phase
        events = self._driven.move(goal)
        ends = self._world.time + _LONGEST_MOTION
        while True:
            self._take(events)
            for event in events:
                if isinstance(event, MotionFinished):
                    said = f"{goal.kind.value} {event.result.reason.value}"
                    note = event.result.message
                    self._course.reasons.append(f"{said}: {note}" if note else said)
                    return event.result
            if self._world.time > ends:
                self._driven.stop()
                ends += _LONGEST_MOTION
            events = self._tick()

    def _tick(self) -> list[Event]:
        events = self._driven.tick()
        self._log.look(self._course.phase)
        self._course.feel(self._world.wrench())
        if self._world.suction().part_present:
            self._course.reached = self._value
        return events

    def _take(self, events: list[Event]) -> None:
        for event in events:
            if isinstance(event, SuctionChanged):
                self._held = event.phase is SuctionPhase.HOLDING
                if event.phase is SuctionPhase.LOST:
                    self._course.breaks.append(self._world.cup.loss_reason)


def _motion_params(opening: Opening, part: TruePart, contact: Array) -> MotionParams:
    """The simulation's, looking ahead over the whole opening, kept to the task's side."""
    params = sim_motion_params()
    ahead = part.way(contact, opening.goal)
    planning = replace(
        params.planning,
        lookahead=ahead,
        pull=not opening.front,
        push_from_front=opening.front,
    )
    return replace(params, planning=planning)


def run_attempt(opening: Opening, seed: int, watch: Watcher = lambda *_: None) -> dict[str, Any]:
    """One run; the seed draws the error of the grasp point, the camera's noise and the planner's.

    Args:
        opening: The task.
        seed: Of the run; equal seeds give equal runs.
        watch: Told of moments worth a picture.

    Returns:
        The record, without what planning took equal for equal arguments.
    """
    began = time.perf_counter()
    part = TruePart(opening)
    error = np.random.default_rng([seed, 5]).normal(0.0, NOISE, 2)
    contact = part.contact(error)
    urdf = compose_urdf()
    params = _motion_params(opening, part, contact)
    course = Course()
    record = RunRecord(opening.name, opening.mode, seed, "ground truth")
    with ArmWorld(urdf, opening.model(), opening.T_base_object) as world:
        camera = DepthCamera(
            world.parts(), look_at(*camera_view(part)), noise=DepthNoise(), seed=seed
        )
        executor = _TimedExecutor(make_kinematics(params, urdf), params, seed)
        executor.planning = course.planning
        perception = PerceptionPipeline(PipelineParams(), urdf)
        driven = ArmPolicyWorld(world, camera, perception, executor, seed, record)
        log = TouchLog(world, executor.robot)
        Attempt(opening, part, contact, world, driven, log, course, watch).run()
        left = world.object_positions()[world.model.target_joint]
        sim_s = world.time
    return _entry(opening, seed, error, course, log, left) | {
        "sim_s": round(sim_s, 2),
        "wall_s": round(time.perf_counter() - began, 1),
        "planning_ms": {
            kind: [round(1e3 * t, 1) for t in times] for kind, times in course.planning.items()
        },
    }


def _entry(
    opening: Opening, seed: int, error: Array, course: Course, log: TouchLog, left: float
) -> dict[str, Any]:
    touches = [asdict(touch) for touch in log.touches.values()]
    return {
        "task": opening.name,
        "seed": seed,
        "reached": course.reached,
        "left": left,
        "opened": bool(course.reached >= opening.wanted),
        "clean": not course.breaks and not touches,
        "suction_breaks": course.breaks,
        "touches": touches,
        "peak_force": course.peak_force,
        "peak_torque": course.peak_torque,
        "reasons": course.reasons,
        "grasp_error": error.tolist(),
    }
