"""Planning of Approach and Retreat: collision-free joint motions from rest to rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flowbothd_common.motion import JointTrajectory, MotionReason
from flowbothd_common.types import Array, JointEstimate
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits, PositionBox
from franka_suction_driver.execution.safety_monitor import workspace
from franka_suction_driver.params import MotionParams
from franka_suction_driver.planning.collision import Box, CollisionChecker, Margins
from franka_suction_driver.planning.departure import escape, leaves_and_stays_free
from franka_suction_driver.planning.inverse_kinematics import follow
from franka_suction_driver.planning.joint_path import SmoothPath, stop_and_go
from franka_suction_driver.planning.opening_path import (
    PlateExtent,
    moving_part,
    plate_extent,
    swings,
)
from franka_suction_driver.planning.rrt_connect import find_path, shorten
from franka_suction_driver.planning.standoff import FOLLOW_TOLERANCE, StandoffSearch

_NEAR_HOME = 8
"""Free configurations near a taken start pose that are kept as goals of a retreat [-]."""
_HOME_TURNS = (0.0, 0.4, -0.4, 0.8, -0.8, 1.2, -1.2)
"""Turns of the first joint out of a start pose that is taken [rad]."""
_HOME_LIFTS = (0.15, 0.3, 0.45, 0.6, 0.8)
"""Turns of the second joint backwards, which lift the tool, out of a taken start pose [rad]."""
_UNFOLDING = 0.03
"""Pull towards the middle of the joint ranges while backing off [-]: it unfolds the arm."""
_BACK_OFF_SPACING = 0.01
"""Largest distance between two checked poses of backing off [m]: below the scene margin."""
_SPACINGS = (0.3, 0.15, 0.07)
"""Distances of spline control points to try, roundest corners first [rad]."""


@dataclass(frozen=True)
class PlannedMotion:
    """What a planning request came to.

    Attributes:
        reason: REACHED = there is a trajectory, otherwise why not.
        message: For people.
        trajectory: From rest to rest; None if there is none, or nothing to do.
        side: +1 = the tool comes from the side of the flow, -1 = from the opposite side.
    """

    reason: MotionReason
    message: str
    trajectory: JointTrajectory | None = None
    side: int = 1


class Planner:
    """Plans free motions against the last known obstacles.

    Not safe to share between threads: it owns its kinematics and its scene.

    Args:
        kinematics: The arm.
        limits: Joint limits.
        params: Parameters of the motion core.
    """

    def __init__(self, kinematics: Kinematics, limits: JointLimits, params: MotionParams) -> None:
        self._kinematics = kinematics
        self._params = params
        self._limits = limits
        margins = Margins(
            params.collision.self_margin,
            params.collision.table_margin,
            params.collision.obstacle_margin,
        )
        self.collision = CollisionChecker(
            kinematics,
            margins,
            table_height=params.collision.table_height,
            cell=params.collision.obstacle_cell,
            workspace=workspace(params.safety),
        )
        self._box: PositionBox = limits.box(params.robot.position_margin)
        self._standoffs = StandoffSearch(kinematics, self.collision, self._box, params)

    def approach(
        self,
        start: Array,
        contact: Array,
        direction: Array,
        joint: JointEstimate | None,
        rng: np.random.Generator,
    ) -> PlannedMotion:
        """Plan to the standoff, from the side of the flow if possible.

        Args:
            start: (J,) configuration at rest.
            contact: (3,) in base [m].
            direction: (3,) unit flow at the contact.
            joint: How the part is expected to move, or None.
            rng: Source of all randomness.
        """
        if not self._params.planning.pull:
            return self._approach_from(-1, start, contact, direction, joint, rng)
        planned = self._approach_from(1, start, contact, direction, joint, rng)
        if planned.trajectory is not None or not self._params.planning.push_from_front:
            return planned
        other = self._approach_from(-1, start, contact, direction, joint, rng)
        if other.trajectory is None:
            return replace(planned, message=f"{planned.message}; opposite side: {other.message}")
        why = f"pushing from the opposite side, since from the side of the flow: {planned.message}"
        return replace(other, message=why)

    def retreat(
        self, start: Array, rng: np.random.Generator, part: Box | None = None
    ) -> PlannedMotion:
        """Plan straight back along the tool axis, then to the start pose, or near it if taken.

        An opened door may stand where the arm started; the arm then waits behind or above.

        Args:
            start: (J,) configuration at rest.
            rng: Source of all randomness.
            part: The part that was held; kept clear of where there is a way to.
        """
        if part is None:
            return self._retreat(start, rng)
        with self.collision.with_boxes([part]):
            planned = self._retreat(start, rng)
        return planned if planned.trajectory is not None else self._retreat(start, rng)

    def _retreat(self, start: Array, rng: np.random.Generator) -> PlannedMotion:
        back = self._back_off(start)
        home = np.array(self._params.robot.start_positions)
        way_out, rest = escape(self.collision, back, [home, *self._near_home(home)])
        if rest is None:
            blocked = self.collision.touch(back[min(len(way_out), len(back) - 1)])
            message = f"backing off does not come free of: {blocked}"
            return PlannedMotion(MotionReason.COLLISION, message)
        taken = self.collision.touch(home)
        goals = home[None] if taken is None else self._near_home(home)
        if not len(goals):
            message = f"the start pose and all near it touch: {taken}; clear the space there"
            return PlannedMotion(MotionReason.COLLISION, message)
        corners = self._connect(rest, goals, rng)
        if corners is None:
            return PlannedMotion(MotionReason.UNREACHABLE, self._no_path("the start pose"))
        points = np.concatenate([way_out, corners[0][1:]]) if len(way_out) > 1 else corners[0]
        note = "" if taken is None else f"stopped near the start pose, which touches: {taken}"
        return PlannedMotion(MotionReason.REACHED, note, self._timed(points))

    def _near_home(self, home: Array) -> Array:
        """(G, J) free configurations around the start pose, nearest first."""
        offsets = np.array([(turn, -lift) for turn in _HOME_TURNS for lift in _HOME_LIFTS])
        offsets = offsets[np.argsort(np.abs(offsets).sum(axis=1), kind="stable")]
        candidates = np.tile(home, (len(offsets), 1))
        candidates[:, :2] += offsets
        free = [q for q in self._box.clip(candidates) if self.collision.free(q)]
        return np.array(free[:_NEAR_HOME])

    def _approach_from(
        self,
        side: int,
        start: Array,
        contact: Array,
        direction: Array,
        joint: JointEstimate | None,
        rng: np.random.Generator,
    ) -> PlannedMotion:
        planning = self._params.planning
        part = None
        if swings(joint, contact):
            extent = plate_extent(contact, direction, joint, self.collision.points)
            part = moving_part(
                contact, direction, side, joint, PlateExtent(extent.low, extent.high)
            )
        with self.collision.with_boxes([] if part is None else [part]):
            found = self._standoffs.best(side, start, contact, direction, joint, part, rng)
        if not len(found.configurations):
            return PlannedMotion(found.reason, found.message, side=side)
        if side < 0 and found.reach < planning.min_push_fraction:
            message = f"only {found.reach:.0%} of the opening could be pushed"
            return PlannedMotion(MotionReason.UNREACHABLE, message, side=side)
        touch = self.collision.touch(start)
        if touch is not None:
            return PlannedMotion(
                MotionReason.COLLISION,
                f"the arm already touches: {touch}; retreat first, or check the object cloud",
                side=side,
            )
        joined = self._connect(start, found.configurations, rng)
        if joined is None:
            return PlannedMotion(MotionReason.UNREACHABLE, self._no_path("the standoff"), side=side)
        note = "" if found.reach >= 1 else f"only {found.reach:.0%} of the opening reachable"
        return PlannedMotion(MotionReason.REACHED, note, self._timed(joined[0]), side)

    def _connect(
        self, start: Array, goals: Array, rng: np.random.Generator
    ) -> tuple[Array, int] | None:
        resolution = self._params.planning.resolution

        def edge_free(a: Array, b: Array) -> bool:
            return self.collision.edge_free(a, b, resolution)

        path = find_path(
            start,
            goals,
            self._box,
            self.collision.free,
            edge_free,
            rng,
            self._params.planning.max_iterations,
        )
        if path is None:
            return None
        return shorten(path.points, edge_free, rng, self._params.planning.shortcuts), path.goal

    def _timed(self, corners: Array) -> JointTrajectory:
        """Time a (P, J) polyline, corners rounded as far as it stays free, or with stops there."""
        limits = self._limits.scaled(self._params.robot.speed_scale)
        names = self._kinematics.joint_names
        for spacing in _SPACINGS:
            path = SmoothPath(corners, spacing)
            samples = path.samples(self._params.planning.resolution)
            if leaves_and_stays_free(self.collision, samples):
                return path.timed(names, limits)
        return stop_and_go(names, corners, limits)

    def _back_off(self, start: Array) -> Array:
        """(K, J) straight back along the tool axis from `start`, as far as the arm reaches."""
        tip = self._kinematics.tip(start)
        distance = self._params.approach.back_off
        ways = np.linspace(0.0, distance, max(2, int(np.ceil(distance / _BACK_OFF_SPACING)) + 1))
        positions = tip.position - np.outer(ways, tip.axis)
        axes = np.tile(tip.axis, (len(ways), 1))
        path = follow(
            self._kinematics, self._box, start[None], positions, axes, centring=_UNFOLDING
        )
        bad = np.flatnonzero(path.error[0] > FOLLOW_TOLERANCE)
        count = bad[0] if len(bad) else len(ways)
        return np.concatenate([start[None], path.positions[0, 1 : max(1, count)]])

    def _no_path(self, goal: str) -> str:
        return (
            f"no collision-free path to {goal} in {self._params.planning.max_iterations} steps; "
            "clear the space around the object or raise planning.max_iterations"
        )
