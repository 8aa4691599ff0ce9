"""Tool motions turned into joint trajectories that stay within every limit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from flowbothd_common.motion import JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.inverse_kinematics import PositionBox, limited_step
from franka_suction_driver.kinematics import (
    Kinematics,
    conditioning,
    damped_inverse,
    task_error,
    task_jacobian,
)
from franka_suction_driver.limits import JointLimits
from franka_suction_driver.tool_motion import OFFSET_BOUNDS, Bounds, Reference, ToolLine
from franka_suction_driver.trajectory import JointState, joint_stop, sample_times

STEP = 0.04
"""Time between two points of a tool trajectory [s]."""
_TOLERANCE = 5e-4
_SLOWINGS = (1.0, 0.75, 0.5, 0.3)
_SHORTENINGS = 5
_STEP_BACK = 0.004
_BRAKINGS = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)
_MOST_SAMPLES = 50
_OFFSET_SHARE = 0.6
_GIVING_WAY = np.array([1.0, 1.0, 1.0, 0.05, 0.05])


@dataclass(frozen=True)
class Rollout:
    """A reference turned into joint motion.

    Attributes:
        trajectory: As far as the reference could be followed, within the joint limits; None if
            not even the first sample could.
        travel: How far along the direction it goes [m].
        problem: Empty, or what ends it early: ``joint_limit`` or ``singularity``.
        too_fast: It breaks a velocity, acceleration or jerk limit.
        slowing: How much slower than asked it had to be planned, 0..1.
        detail: For people.
    """

    trajectory: JointTrajectory | None
    travel: float
    problem: str = ""
    detail: str = ""
    too_fast: bool = False
    slowing: float = 1.0

    @property
    def good(self) -> bool:
        """Whether it goes all the way within the limits."""
        return self.trajectory is not None and not self.problem


class ToolFollower:
    """Turns references into joint trajectories.

    Args:
        kinematics: The arm.
        limits: Joint limits, never exceeded.
        box: Position limits with their margin.
        tilt_slack: Tilt that is accepted in order to stay in reach [rad].
    """

    def __init__(
        self, kinematics: Kinematics, limits: JointLimits, box: PositionBox, tilt_slack: float
    ) -> None:
        self._kinematics = kinematics
        self._limits = limits
        self._box = box
        self._slack = tilt_slack

    def rollout(self, reference: Reference, now: float, start: JointState) -> Rollout:
        """Follow the reference from `now` to its end, beginning in the commanded state `start`.

        Args:
            reference: What the tool shall do.
            now: Time on the motion's clock [s].
            start: Commanded joint state at that time.
        """
        duration = reference.end - now
        times = sample_times(duration, max(STEP, duration / _MOST_SAMPLES))
        positions = np.empty((len(times), self._kinematics.dof))
        q = start.position
        for k, time in enumerate(times):
            reached = self._reach(q, *reference.pose(now + time))
            if reached is None:
                travel = float(reference.travel(now + time).position[0])
                return Rollout(None, travel, *self._why(q))
            q = positions[k] = reached
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
        violation = self._limits.violation(trajectory)
        if violation is not None:
            travel = float(reference.travel(now + violation.time).position[0])
            kind, _ = self._why(positions[int(np.searchsorted(times, violation.time))])
            return Rollout(trajectory, travel, kind, str(violation), too_fast=True)
        return Rollout(trajectory, float(reference.travel(reference.end).position[0]))

    def plan(self, line: ToolLine, bounds: Bounds, start: JointState) -> tuple[Reference, Rollout]:
        """A reference from rest that is within reach and within the joint limits.

        It is slowed down until the limits hold, and shortened to what the arm can reach; what
        made it shorter is the problem of the rollout. Without any way to go, the rollout has no
        trajectory.
        """
        goal = line.length
        shortened: Rollout | None = None
        for _ in range(_SHORTENINGS):
            for slowing in _SLOWINGS:
                reference = Reference.start(line, bounds.scaled(slowing))
                if goal < line.length:
                    reference.redirect(0.0, goal, bounds.scaled(slowing))
                rollout = self.rollout(reference, 0.0, start)
                if not rollout.too_fast:
                    break
            if rollout.good:
                reference.offset_bounds = self._offset_bounds(rollout, line.direction)
                why = ("", "") if shortened is None else (shortened.problem, shortened.detail)
                return reference, replace(rollout, slowing=slowing, problem=why[0], detail=why[1])
            shortened = rollout
            goal = min(rollout.travel, goal) - _STEP_BACK
            if goal < _STEP_BACK:
                break
        why = ("singularity", "") if shortened is None else (shortened.problem, shortened.detail)
        return Reference.start(line, bounds), Rollout(None, 0.0, *why)

    def brake(
        self, reference: Reference, now: float, start: JointState
    ) -> tuple[Reference, JointTrajectory]:
        """Stop along the direction as hard as the joint limits allow; the offset keeps its goal.

        Args:
            reference: What the tool was doing.
            now: Time on the motion's clock [s].
            start: Commanded joint state at that time.
        """
        slowest = replace(reference)
        for hardness in _BRAKINGS:
            slowest = replace(reference)
            slowest.halt(now, Bounds(0.1, hardness, 40.0 * hardness))
            slowest.shift(now, slowest.offset_state(now).position)
            rollout = self.rollout(slowest, now, start)
            if rollout.good and rollout.trajectory is not None:
                return slowest, rollout.trajectory
        # Off the line, but to rest within the limits, which comes first.
        return slowest, joint_stop(self._kinematics.joint_names, start, self._limits)

    def _offset_bounds(self, rollout: Rollout, direction: Array) -> Bounds:
        """How hard the tool may be moved sideways anywhere on the way, by the joints' limits."""
        if rollout.trajectory is None:
            return OFFSET_BOUNDS
        count = len(rollout.trajectory.positions)
        picked = rollout.trajectory.positions[:: max(1, count // 6)]
        inverse = damped_inverse(task_jacobian(self._kinematics.tip(picked)), 0.01)[..., :3]
        sideways = inverse @ (np.eye(3) - np.outer(direction, direction))
        needed = np.linalg.norm(sideways, axis=-1).max(axis=0)
        share = float((_OFFSET_SHARE * self._limits.acceleration / needed).min())
        factor = min(1.0, share / OFFSET_BOUNDS.acceleration)
        return Bounds(
            OFFSET_BOUNDS.speed, OFFSET_BOUNDS.acceleration * factor, OFFSET_BOUNDS.jerk * factor
        )

    def _reach(self, q: Array, position: Array, axis: Array) -> Array | None:
        """Configuration next to `q` at the tool pose, tilted as little as needed, or None."""
        for attempt in range(12):
            state = self._kinematics.tip(q)
            miss = task_error(state, position, axis)
            if np.linalg.norm(miss) < 1e-7:
                return q
            jacobian = task_jacobian(state)
            if attempt >= 3:
                # Out of reach as asked: hold the position and let the tilt give way.
                if np.linalg.norm(miss[:3]) < _TOLERANCE / 5:
                    break
                miss, jacobian = miss * _GIVING_WAY, jacobian * _GIVING_WAY[:, None]
            elif attempt and np.linalg.norm(miss) < 1e-5:
                return q
            q = self._box.clip(q + limited_step(self._box, q, jacobian, miss))
        miss = task_error(self._kinematics.tip(q), position, axis)
        near = np.linalg.norm(miss[:3]) < _TOLERANCE
        return q if near and np.linalg.norm(miss[3:]) < max(self._slack, 1e-3) else None

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
