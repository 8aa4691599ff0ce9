"""Tool motions turned into joint trajectories that stay within every limit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from flowbothd_common.motion import JointState, JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import (
    Kinematics,
    conditioning,
    damped_inverse,
    task_jacobian,
)
from franka_suction_driver.arm.limits import JointLimits, PositionBox, Violation
from franka_suction_driver.arm.trajectory import joint_stop, sample_times
from franka_suction_driver.arm.trajectory_check import fine_violation
from franka_suction_driver.execution.local_ik import LocalIk
from franka_suction_driver.execution.tool_path import ToolPath, solve_path
from franka_suction_driver.execution.tool_reference import (
    OFFSET_BOUNDS,
    Bounds,
    Reference,
    ToolLine,
)

STEP = 0.04
"""Time between two points of a tool trajectory [s]."""
_SLOWINGS = (1.0, 0.6, 0.3, 0.15)
"""Parts of the speed to try, fastest first [-]."""
_SHORTENINGS = 5
"""Lengths to try before a motion counts as impossible: each costs up to four timings."""
_SLOWEST = 0.1
"""Least part of the speed near singularities and joint limits [-]: slower, a step would never
end."""
_STEP_BACK = 0.004
"""Way that a motion is shortened by beyond what breaks a limit [m]."""
_BRAKINGS = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)
"""Decelerations to try, hardest first [m/s^2]."""
_JERK_PER_BRAKING = 40.0
"""Jerk per deceleration while braking [1/s]: full deceleration after 25 ms."""
_BRAKING_SPEED = 0.1
"""Speed that `Bounds` asks for [m/s]; braking has no use for it."""
_MOST_SAMPLES = 50
"""Points of a trajectory at most: longer motions get sparser points, so that following a reference
stays within a few milliseconds."""
_OFFSET_SHARE = 0.6
"""Part of the joints' acceleration that sideways motion may use [-]; the rest is for the motion
along the direction."""
_RESERVE = 0.02
"""Part of every limit that planned motions leave free [-]: velocities are checked at five places
between two points, and the worst may lie between those."""
_POWERS = {"position": 0, "velocity": 1, "acceleration": 2, "jerk": 3}
"""Powers of the slowing by which velocity, acceleration and jerk shrink [-]; positions stay."""
_DOUBT = 1.1
"""Ratio to a limit above which a slower motion is not even tried [-]: its points lie elsewhere, so
that a smaller excess may still vanish."""


@dataclass(frozen=True)
class TimedTrajectory:
    """A reference turned into joint motion.

    Attributes:
        trajectory: As far as the reference could be followed, within the joint limits; None if
            not even the first sample could.
        travel: How far along the direction it goes [m].
        problem: Empty, or what ends it early: ``joint_limit`` or ``singularity``.
        excess: The limit that it breaks worst, if any.
        slowing: How much slower than asked it had to be planned, 0..1.
        detail: For people.
        path: The joint path that was timed, of planned motions.
    """

    trajectory: JointTrajectory | None
    travel: float
    problem: str = ""
    detail: str = ""
    excess: Violation | None = None
    slowing: float = 1.0
    path: ToolPath | None = None

    @property
    def too_fast(self) -> bool:
        """Whether it breaks a limit."""
        return self.excess is not None

    @property
    def good(self) -> bool:
        """Whether it goes all the way within the limits."""
        return self.trajectory is not None and not self.problem and not self.too_fast


@dataclass(frozen=True)
class SlowZones:
    """Where the tool slows down, in proportion, down to a least part of its speed.

    Attributes:
        conditioning: Below this smallest singular value of the tool's Jacobian [m/rad]; 0 = never.
        margin: Nearer than this to a joint limit [rad]; 0 = never.
    """

    conditioning: float
    margin: float

    def slowing(self, kinematics: Kinematics, box: PositionBox, path: Array) -> float:
        """Part of the speed, 0.1..1, that a path of configurations (K, J) is worth."""
        part = 1.0
        if self.conditioning > 0:
            part = float(conditioning(kinematics.tip(path)).min()) / self.conditioning
        if self.margin > 0:
            part = min(part, float(box.margin(path).min()) / self.margin)
        return float(np.clip(part, _SLOWEST, 1.0))


class CartesianPlanner:
    """Turns references into joint trajectories.

    Args:
        kinematics: The arm.
        limits: Joint limits, never exceeded.
        box: Position limits with their margin.
        tilt_slack: Tilt that is accepted in order to stay in reach [rad].
        zones: Where planned motions slow down.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        limits: JointLimits,
        box: PositionBox,
        tilt_slack: float,
        zones: SlowZones | None = None,
    ) -> None:
        self._kinematics = kinematics
        self._limits = limits
        self._box = box
        self._solver = LocalIk(kinematics, box, tilt_slack)
        self._zones = zones or SlowZones(0.0, 0.0)

    def follow(self, reference: Reference, now: float, start: JointState) -> TimedTrajectory:
        """Follow the reference from `now` to its end, beginning in the commanded state `start`.

        Args:
            reference: What the tool shall do.
            now: Time on the motion's clock [s].
            start: Commanded joint state at that time.
        """
        duration = reference.end - now
        times = sample_times(duration, max(STEP, duration / _MOST_SAMPLES))
        positions = np.empty((len(times), self._kinematics.dof))
        q = before = start.position
        for k, time in enumerate(times):
            guess = self._solver.ahead(before, q)
            reached = self._solver.reach(guess, *reference.pose(now + time))
            if reached is None:
                travel = float(reference.travel(now + time).position[0])
                return TimedTrajectory(None, travel, *self._why(q))
            before, q = q, reached
            positions[k] = q
        rates = CubicSpline(
            np.concatenate([[0.0], times]),
            np.vstack([start.position, positions]),
            bc_type=((1, start.velocity), (1, np.zeros_like(q))),
        )
        velocities, accelerations = rates(times, 1), rates(times, 2)
        velocities[-1] = 0.0
        accelerations[-1] = 0.0
        names = self._kinematics.joint_names
        trajectory = JointTrajectory(names, times, positions, velocities, accelerations)
        violation = fine_violation(self._limits, trajectory, start, -_RESERVE)
        if violation is not None:
            travel = float(reference.travel(now + violation.time).position[0])
            return TimedTrajectory(trajectory, travel, detail=str(violation), excess=violation)
        return TimedTrajectory(trajectory, float(reference.travel(reference.end).position[0]))

    def plan(
        self, line: ToolLine, bounds: Bounds, start: JointState
    ) -> tuple[Reference, TimedTrajectory]:
        """A reference from rest that is within reach and within the joint limits.

        It is slowed down until the limits hold and where the arm comes near a singularity or a
        joint limit, and shortened to what the arm can reach; what made it shorter is the problem
        of the timed. Without any way to go, the timed has no trajectory.
        """
        path = solve_path(line, start.position, self._solver)
        goal, why = path.length, ("", "")
        if goal < line.length:
            why = self._why(path.nodes[-1])
        caution = self._zones.slowing(self._kinematics, self._box, path.nodes)
        for _ in range(_SHORTENINGS):
            if goal < _STEP_BACK:
                break
            tried, excess = 1.0, None
            for slowing in (caution * part for part in _SLOWINGS):
                if excess is not None and _still_beyond(excess, slowing / tried):
                    continue
                reference = Reference.start(line, bounds.scaled(slowing), goal)
                timed = self.retimed(path, reference, 0.0, start)
                tried, excess = slowing, timed.excess
                if timed.good:
                    planned = replace(timed, problem=why[0], detail=why[1], slowing=slowing)
                    return reference, planned
            why = (self._tight(timed), timed.detail)
            goal = min(goal, timed.travel) - _STEP_BACK
        why = why if why[0] else ("singularity", "")
        return Reference.start(line, bounds), TimedTrajectory(None, 0.0, *why)

    def retimed(
        self, path: ToolPath, reference: Reference, now: float, start: JointState
    ) -> TimedTrajectory:
        """A solved path under the timing of a reference without any offset.

        Args:
            path: Along the reference's line.
            reference: Leads no further than the path.
            now: Time on the motion's clock [s].
            start: Commanded joint state at that time.
        """
        duration = reference.along_end - now
        times = sample_times(duration, max(STEP, duration / _MOST_SAMPLES))
        trajectory = path.timed(self._kinematics.joint_names, reference, times, now)
        violation = fine_violation(self._limits, trajectory, start, -_RESERVE)
        if violation is None:
            travel = float(reference.travel(reference.along_end).position[0])
            return TimedTrajectory(trajectory, travel, path=path)
        travel = float(reference.travel(now + violation.time).position[0])
        return TimedTrajectory(trajectory, travel, detail=str(violation), excess=violation)

    def brake(
        self,
        reference: Reference,
        now: float,
        start: JointState,
        path: ToolPath | None = None,
    ) -> tuple[Reference, JointTrajectory]:
        """Stop along the direction as hard as the joint limits allow; the offset keeps its goal.

        Args:
            reference: What the tool was doing.
            now: Time on the motion's clock [s].
            start: Commanded joint state at that time.
            path: The solved path, for a reference without offset.
        """
        slowest = replace(reference)
        for hardness in _BRAKINGS:
            slowest = replace(reference)
            slowest.halt(now, Bounds(_BRAKING_SPEED, hardness, _JERK_PER_BRAKING * hardness))
            if path is None:
                slowest.shift(now, slowest.offset_state(now).position)
                timed = self.follow(slowest, now, start)
            elif slowest.travel(slowest.along_end).position[0] <= path.length:
                timed = self.retimed(path, slowest, now, start)
            else:
                continue
            if timed.good and timed.trajectory is not None:
                return slowest, timed.trajectory
        # Off the line, but to rest within the limits, which comes first.
        return slowest, joint_stop(self._kinematics.joint_names, start, self._limits)

    def offset_bounds(self, timed: TimedTrajectory, direction: Array) -> Bounds:
        """How hard the tool may be moved sideways anywhere on the way, by the joints' limits.

        Args:
            timed: A planned motion.
            direction: (3,) its unit direction.
        """
        if timed.trajectory is None:
            return OFFSET_BOUNDS
        count = len(timed.trajectory.positions)
        picked = timed.trajectory.positions[:: max(1, count // 6)]
        inverse = damped_inverse(task_jacobian(self._kinematics.tip(picked)), 0.01)[..., :3]
        sideways = inverse @ (np.eye(3) - np.outer(direction, direction))
        needed = np.linalg.norm(sideways, axis=-1).max(axis=0)
        share = float((_OFFSET_SHARE * self._limits.acceleration / needed).min())
        factor = min(1.0, share / OFFSET_BOUNDS.acceleration)
        return Bounds(
            OFFSET_BOUNDS.speed, OFFSET_BOUNDS.acceleration * factor, OFFSET_BOUNDS.jerk * factor
        )

    def _tight(self, timed: TimedTrajectory) -> str:
        """What makes the joints move too fast where a timed breaks its limit worst."""
        trajectory, excess = timed.trajectory, timed.excess
        if trajectory is None or excess is None:
            return timed.problem
        index = int(np.searchsorted(trajectory.times, excess.time))
        return self._why(trajectory.positions[min(index, len(trajectory.times) - 1)])[0]

    def _why(self, q: Array) -> tuple[str, str]:
        lower, upper = q - self._box.lower, self._box.upper - q
        room = np.minimum(lower, upper)
        if room.min() < 1e-3:
            joint = int(room.argmin())
            name = self._kinematics.joint_names[joint]
            end = "lower" if lower[joint] < upper[joint] else "upper"
            return "joint_limit", f"{name} is at its {end} limit ({q[joint]:.2f} rad)"
        value = float(conditioning(self._kinematics.tip(q)))
        return "singularity", f"the arm is stretched out (smallest singular value {value:.3f})"


def _still_beyond(excess: Violation, part: float) -> bool:
    """Whether the same motion is too fast at `part` of its speed as well, beyond doubt."""
    return excess.ratio * part ** _POWERS[excess.what] > _DOUBT
