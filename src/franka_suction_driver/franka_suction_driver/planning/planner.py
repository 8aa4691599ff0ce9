"""Approach and Retreat: which arm configuration to go to, and how to get there without touching.

The configuration at the standoff is chosen for what comes after it: among all that reach it,
those from which the contact and then the longest part of the opening stay reachable.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.motion import JointTrajectory, MotionReason
from flowbothd_common.transforms import rotation_about, unit
from flowbothd_common.types import Array, JointEstimate
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits, PositionBox
from franka_suction_driver.execution.envelope import workspace
from franka_suction_driver.params import MotionParams
from franka_suction_driver.planning.collision import Box, CollisionChecker, Margins
from franka_suction_driver.planning.continuation import (
    PlateExtent,
    ToolPoses,
    moving_part,
    opening_poses,
    plate_extent,
    swings,
)
from franka_suction_driver.planning.escape import TOOL_LINKS, escape, leaves_and_stays_free
from franka_suction_driver.planning.inverse_kinematics import follow, solve
from franka_suction_driver.planning.joint_path import SmoothPath, stop_and_go
from franka_suction_driver.planning.path_search import find_path, shorten

_GOALS = 8
_CANDIDATES = 24
_UNFOLDING = 0.03
_FOLLOW_TOLERANCE = 0.003
_SPACINGS = (0.3, 0.15, 0.07)
_ROOM_FACTORS = (4.0, 2.0, 1.0)


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


@dataclass(frozen=True)
class _Branches:
    """Configurations at the standoff, best first, or why there are none."""

    reason: MotionReason
    message: str
    standoffs: Array
    reach: float = 0.0


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
        self.collision.set_boxes([part])
        planned = self._retreat(start, rng)
        self.collision.set_boxes([])
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
        turns = np.array([0.0, 0.4, -0.4, 0.8, -0.8, 1.2, -1.2])
        lifts = np.array([0.15, 0.3, 0.45, 0.6, 0.8])
        offsets = np.array([(turn, -lift) for turn in turns for lift in lifts])
        offsets = offsets[np.argsort(np.abs(offsets).sum(axis=1), kind="stable")]
        candidates = np.tile(home, (len(offsets), 1))
        candidates[:, :2] += offsets
        free = [q for q in self._box.clip(candidates) if self.collision.free(q)]
        return np.array(free[:_GOALS])

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
        slack = planning.tilt_slack if side > 0 else self._params.flow_step.push_lag
        part = None
        if swings(joint, contact):
            extent = plate_extent(contact, direction, joint, self.collision.points)
            part = moving_part(
                contact, direction, side, joint, PlateExtent(extent.low, extent.high)
            )
        self.collision.set_boxes([] if part is None else [part])
        branches: _Branches | None = None
        for tilt in _tilts(direction, planning.tilt_slack):
            poses = opening_poses(
                contact,
                direction,
                side,
                self._params.approach.standoff,
                planning.lookahead,
                joint,
                tilt=tilt,
                back_off=self._params.approach.back_off,
                tilt_slack=slack,
            )
            found = self._branches(start, poses, part, rng)
            # What kept the straight tool away is the better explanation.
            if branches is None or len(found.standoffs):
                branches = found
            if len(found.standoffs):
                break
        self.collision.set_boxes([])
        if branches is None:
            raise RuntimeError("no tilt was tried")
        if not len(branches.standoffs):
            return PlannedMotion(branches.reason, branches.message, side=side)
        if side < 0 and branches.reach < planning.min_push_fraction:
            message = f"only {branches.reach:.0%} of the opening could be pushed"
            return PlannedMotion(MotionReason.UNREACHABLE, message, side=side)
        touch = self.collision.touch(start)
        if touch is not None:
            return PlannedMotion(
                MotionReason.COLLISION,
                f"the arm already touches: {touch}; retreat first, or check the object cloud",
                side=side,
            )
        joined = self._connect(start, branches.standoffs, rng)
        if joined is None:
            return PlannedMotion(MotionReason.UNREACHABLE, self._no_path("the standoff"), side=side)
        note = "" if branches.reach >= 1 else f"only {branches.reach:.0%} of the opening reachable"
        return PlannedMotion(MotionReason.REACHED, note, self._timed(joined[0]), side)

    def _branches(
        self, start: Array, poses: ToolPoses, part: Box | None, rng: np.random.Generator
    ) -> _Branches:
        """Free standoff configurations from which the contact is reached, best first."""
        none = np.empty((0, self._kinematics.dof))
        seeds = np.vstack(
            [
                start,
                self._params.robot.start_positions,
                self._box.sample(rng, self._params.planning.ik_seeds),
            ]
        )
        found = solve(self._kinematics, self._box, seeds, poses.positions[0], poses.axes[0])
        if not len(found):
            return _Branches(MotionReason.UNREACHABLE, self._out_of_reach(poses, 0), none)
        path = follow(self._kinematics, self._box, found, poses.positions, poses.axes)
        bad = path.error > _FOLLOW_TOLERANCE
        reach = np.where(bad.any(axis=1), bad.argmax(axis=1), len(poses.positions))
        if reach.max() <= poses.contact:
            return _Branches(MotionReason.UNREACHABLE, self._out_of_reach(poses, 1), none)
        touches: list[str] = []
        free = self._roomy_branches(path.positions, reach, poses, part, touches)
        if free.max() <= poses.contact:
            where = touches[0] if touches else "the arm with the scene"
            return _Branches(MotionReason.COLLISION, f"at the contact touches: {where}", none)
        best = np.flatnonzero(free == free.max())
        # Roomy joints first, then the short way: as many radians of travel as radians of margin.
        room = np.minimum(path.margin[best, : free.max()].min(axis=1), 0.3)
        travel = np.abs(found[best] - start).max(axis=1)
        ranked = best[np.argsort(0.2 * travel - room)]
        if free.max() < len(poses.positions):
            ranked = self._least_blocked(ranked[:_CANDIDATES], path.positions, reach, poses, part)
        total = poses.opened - poses.contact
        followed = 1.0 if total == 0 else (free.max() - 1 - poses.contact) / total
        return _Branches(
            MotionReason.REACHED, "", found[ranked[:_GOALS]], min(1.0, float(followed))
        )

    def _roomy_branches(
        self, paths: Array, reach: Array, poses: ToolPoses, part: Box | None, touches: list[str]
    ) -> Array:
        """How far each branch is free; with more room than needed, if a whole opening has it."""
        free = np.zeros(len(paths), dtype=int)
        for factor in _ROOM_FACTORS:
            self.collision.set_scene_margin(factor * self.collision.scene_margin)
            touches.clear()
            free = np.zeros(len(paths), dtype=int)
            for i in np.argsort(-reach, kind="stable"):
                if reach[i] <= max(poses.contact, free.max() - 1):
                    break
                free[i] = self._free_poses(paths[i, : reach[i]], poses, part, touches)
            if free.max() == len(poses.positions):
                break
        self.collision.set_scene_margin(self.collision.scene_margin)
        return free

    def _least_blocked(
        self,
        ranked: NDArray[np.intp],
        paths: Array,
        reach: Array,
        poses: ToolPoses,
        part: Box | None,
    ) -> NDArray[np.intp]:
        """Those of some branches that get farthest without any margin.

        What is seen is kept from by more than it takes; where that blocks the opening, flow steps
        go on all the same, and branches differ in what they then really touch.
        """
        self.collision.set_scene_margin(0.0)
        counts = [self._free_poses(paths[i, : reach[i]], poses, part, []) for i in ranked]
        self.collision.set_scene_margin(self.collision.scene_margin)
        return np.array([i for i, n in zip(ranked, counts, strict=True) if n == max(counts)])

    def _free_poses(
        self, path: Array, poses: ToolPoses, part: Box | None, touches: list[str]
    ) -> int:
        """How many configurations are free; the cup may touch, once it has left standoff."""
        for k, q in enumerate(path):
            if part is not None:
                self.collision.move_box(part.name, poses.part[k] @ part.pose)
            touch = self.collision.touch(q, contact_links=() if k == 0 else TOOL_LINKS)
            if touch is not None:
                touches.append(str(touch))
                return k
        return len(path)

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
        ways = np.linspace(0.0, distance, max(2, int(np.ceil(distance / 0.01)) + 1))
        positions = tip.position - np.outer(ways, tip.axis)
        axes = np.tile(tip.axis, (len(ways), 1))
        path = follow(
            self._kinematics, self._box, start[None], positions, axes, centring=_UNFOLDING
        )
        bad = np.flatnonzero(path.error[0] > _FOLLOW_TOLERANCE)
        count = bad[0] if len(bad) else len(ways)
        return np.concatenate([start[None], path.positions[0, 1 : max(1, count)]])

    def _out_of_reach(self, poses: ToolPoses, stage: int) -> str:
        where = "standoff" if stage == 0 else "contact"
        index = 0 if stage == 0 else poses.contact
        position = np.round(poses.positions[index], 3).tolist()
        axis = np.round(poses.axes[index], 2).tolist()
        return (
            f"no joint configuration takes the cup to the {where} {position} m with the tool along "
            f"{axis}; move the object nearer to the arm or turn it"
        )

    def _no_path(self, goal: str) -> str:
        return (
            f"no collision-free path to {goal} in {self._params.planning.max_iterations} steps; "
            "clear the space around the object or raise planning.max_iterations"
        )


def _tilts(direction: Array, slack: float) -> list[Array]:
    """(3, 3) turns of the tool to try: none, then by `slack` [rad] to four sides."""
    tilts = [np.eye(3)]
    if slack > 0:
        side = np.eye(3)[int(np.argmin(np.abs(direction)))]
        first = unit(np.cross(direction, side))
        for axis in (first, np.cross(direction, first)):
            tilts += [rotation_about(axis, slack), rotation_about(axis, -slack)]
    return tilts
