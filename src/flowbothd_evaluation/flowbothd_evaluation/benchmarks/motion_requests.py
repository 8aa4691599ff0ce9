"""Random motion requests, run against an arm that follows exactly, and what must hold of each.

The arm, its limits and the executor are the real ones; the world is empty but for a box that is
approached. Some requests are stopped on the way, some are pushed sideways while they move.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from flowbothd_common.errors import MotionRejectedError
from flowbothd_common.motion import (
    JointState,
    JointTrajectory,
    MotionGoal,
    MotionKind,
    MotionReason,
    RobotObservation,
)
from flowbothd_common.transforms import unit
from flowbothd_common.types import Array, Cloud
from franka_suction_driver.arm.commanded_state import CommandedState
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.arm.trajectory_check import fine_samples
from franka_suction_driver.execution.executor import MotionExecutor

PERIOD = 1 / 60
_LONGEST = 90.0
_FINE = np.linspace(0.0, 1.0, 16)
"""Where between two samples to look; planning itself looks at fewer places."""
_KINDS = (MotionKind.FLOW_STEP, MotionKind.PROBE, MotionKind.APPROACH, MotionKind.RETREAT)
_SHARES = (0.45, 0.3, 0.2, 0.05)


@dataclass(frozen=True)
class Request:
    """One motion to ask for.

    Attributes:
        goal: The motion.
        start: (J,) where the arm rests.
        cloud: What is observed, or None.
        stop_at: When it is stopped [s], infinite = never.
        force: (3,) constant force on the tool [N].
    """

    goal: MotionGoal
    start: Array
    cloud: Cloud | None = None
    stop_at: float = np.inf
    force: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def free(self) -> bool:
        """Nothing disturbs it."""
        return bool(np.isinf(self.stop_at)) and not self.force.any()


@dataclass(frozen=True)
class Verdict:
    """What became of a request.

    Attributes:
        kind: Which motion.
        reason: Why it ended.
        planning: Thread time from the request to its first trajectory [s].
        wall: The same on the wall clock [s].
        sample_ratio: Largest amount over its limit at the samples of all trajectories.
        fine_ratio: The same between the samples, as a controller interpolates.
        fine_what: Which limit that is.
        end_speed: Largest joint speed at the end of any trajectory [rad/s].
        bend: Largest distance of the tip from the straight line [m]; of free flow steps.
        trajectories: How many were issued.
        fault: What must never be, in words.
    """

    kind: str
    reason: str
    planning: float = 0.0
    wall: float = 0.0
    sample_ratio: float = 0.0
    fine_ratio: float = 0.0
    fine_what: str = ""
    end_speed: float = 0.0
    bend: float = 0.0
    trajectories: int = 0
    fault: str = ""

    def entry(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def draw(executor: MotionExecutor, rng: np.random.Generator) -> Request:
    """A random request that an arm at rest might get."""
    kind = _KINDS[int(rng.choice(len(_KINDS), p=_SHARES))]
    stop_at = float(rng.uniform(0.05, 2.0)) if rng.random() < 0.2 else np.inf
    if kind is MotionKind.APPROACH:
        return _draw_approach(executor, stop_at, rng)
    start = _free_start(executor, rng)
    if kind is MotionKind.RETREAT:
        return Request(MotionGoal(kind), start, stop_at=stop_at)
    axis = executor.robot.tip(start).axis
    sideways = rng.normal(size=3) * 0.4
    if kind is MotionKind.PROBE:
        return Request(MotionGoal(kind, None, unit(axis + sideways)), start, stop_at=stop_at)
    force = rng.normal(size=3) * 4.0 if rng.random() < 0.3 else np.zeros(3)
    goal = MotionGoal(kind, None, unit(-axis + sideways))
    return Request(goal, start, stop_at=stop_at, force=force)


def run_request(
    executor: MotionExecutor, request: Request, *, only_planning: bool = False
) -> Verdict:
    """Ask for it, let an arm that follows exactly do it, and look at everything that was sent.

    Args:
        executor: At rest.
        request: What to do.
        only_planning: Give up once the first trajectory is there; for timing.
    """
    kind = request.goal.kind
    arm = CommandedState()
    arm.reset(request.start)
    clock = 100.0
    executor.set_obstacles(request.cloud)
    began, wall_began = time.thread_time(), time.perf_counter()
    planning: tuple[float, float] | None = None
    sent: list[tuple[JointState, JointTrajectory]] = []
    tips = [executor.robot.tip(request.start).position]
    try:
        executor.start(request.goal, _seen(arm, clock, request, kind))
    except MotionRejectedError:
        return Verdict(kind.value, MotionReason.REJECTED.value)
    stopped = False
    while clock < 100.0 + _LONGEST:
        if clock - 100.0 >= request.stop_at and not stopped:
            stopped = executor.stop()
        update = executor.tick(_seen(arm, clock, request, kind))
        if planning is None:
            planning = time.thread_time() - began, time.perf_counter() - wall_began
            if only_planning:
                if update.result is None:
                    executor.abandon(_seen(arm, clock, request, kind))
                return Verdict(kind.value, "planned", *planning)
        if update.trajectory is not None:
            sent.append((arm.state(clock), update.trajectory))
            arm.issue(update.trajectory, clock)
        if update.result is not None:
            return _judged(executor, request, update.result.reason, planning, sent, np.array(tips))
        clock += PERIOD
        if request.free:
            tips.append(executor.robot.tip(arm.state(clock).position).position)
    executor.abandon(_seen(arm, clock, request, kind))
    return Verdict(kind.value, "endless", fault=f"no end within {_LONGEST:.0f} s")


def worst_between(
    limits: JointLimits, start: JointState, trajectory: JointTrajectory
) -> tuple[float, str]:
    """Largest amount over its limit between the samples, as a controller goes, and of what."""
    fine = fine_samples(trajectory, start, _FINE)
    centre, half = (limits.upper + limits.lower) / 2, (limits.upper - limits.lower) / 2
    ratios = {
        "position": np.abs(fine.positions - centre) / half,
        "velocity": np.abs(fine.velocities) / limits.velocity,
        "acceleration": np.abs(fine.accelerations) / limits.acceleration,
        "jerk": np.abs(fine.jerks) / limits.jerk,
    }
    worst = {name: float(values.max()) for name, values in ratios.items()}
    what = max(worst, key=lambda name: worst[name])
    return worst[what], what


def _judged(
    executor: MotionExecutor,
    request: Request,
    reason: MotionReason,
    planning: tuple[float, float],
    sent: list[tuple[JointState, JointTrajectory]],
    tips: Array,
) -> Verdict:
    limits = executor.limits
    fault, sample, fine, what, speed = "", 0.0, 0.0, "", 0.0
    for start, trajectory in sent:
        violation = limits.violation(trajectory, tolerance=1e-6)
        if violation is not None:
            sample, fault = max(sample, violation.ratio), f"at a sample: {violation}"
        ratio, name = worst_between(limits, start, trajectory)
        if ratio > fine:
            fine, what = ratio, name
        speed = max(speed, float(np.abs(trajectory.velocities[-1]).max()))
    if speed > 0:
        fault = f"the last velocity is {speed:.2g} rad/s"
    bend = 0.0
    direction = request.goal.direction
    if request.free and request.goal.kind is MotionKind.FLOW_STEP and direction is not None:
        offset = tips - tips[0]
        along = np.outer(offset @ direction, direction)
        bend = float(np.linalg.norm(offset - along, axis=1).max())
    kind = request.goal.kind.value
    return Verdict(kind, reason.value, *planning, sample, fine, what, speed, bend, len(sent), fault)


def _seen(
    arm: CommandedState, clock: float, request: Request, kind: MotionKind
) -> RobotObservation:
    state = arm.state(clock)
    wrench = np.concatenate([request.force, np.zeros(3)])
    holds = kind is MotionKind.FLOW_STEP
    return RobotObservation(clock, state.position, state.velocity, wrench, holds, False)


def _free_start(executor: MotionExecutor, rng: np.random.Generator) -> Array:
    box = executor.limits.box(executor.params.robot.position_margin)
    while True:
        q = box.sample(rng, 1)[0]
        if executor.robot.tip(q).position[2] > 0.05 and executor.is_free(q):
            return np.asarray(q)


def _draw_approach(executor: MotionExecutor, stop_at: float, rng: np.random.Generator) -> Request:
    """The arm in its start pose, and a box on the table with the contact on one of its faces."""
    size = rng.uniform((0.05, 0.2, 0.15), (0.25, 0.4, 0.45))
    centre = np.array([rng.uniform(0.4, 0.65), rng.uniform(-0.25, 0.25), size[2] / 2])
    turn = rng.uniform(-np.pi, np.pi)
    rotation = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]]
    )
    surface = rng.uniform(-0.5, 0.5, (2500, 3))
    faces = rng.integers(0, 3, len(surface))
    surface[np.arange(len(surface)), faces] = rng.choice([-0.5, 0.5], len(surface))
    normal = -rotation[:, 0] if (rotation[:, 0] @ centre) > 0 else rotation[:, 0]
    local = np.array([0.5 * np.sign(normal @ rotation[:, 0]), *rng.uniform(-0.35, 0.35, 2)])
    contact = centre + rotation @ (local * size)
    cloud = (surface * size) @ rotation.T + centre
    goal = MotionGoal(MotionKind.APPROACH, contact, normal)
    start = np.array(executor.params.robot.start_positions)
    return Request(goal, start, cloud[cloud[:, 2] > 0.02].astype(np.float32), stop_at)
