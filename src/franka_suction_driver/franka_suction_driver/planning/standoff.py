"""Choice of the arm configuration at the standoff: the one from which most of the opening works.

Among all configurations that reach the standoff, those are chosen from which the contact and then
the longest part of the opening stay reachable and free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.motion import MotionReason
from flowbothd_common.transforms import rotation_about, unit
from flowbothd_common.types import Array, JointEstimate
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import PositionBox
from franka_suction_driver.params import MotionParams
from franka_suction_driver.planning.collision import Box, CollisionChecker
from franka_suction_driver.planning.departure import TOOL_LINKS
from franka_suction_driver.planning.inverse_kinematics import follow, solve
from franka_suction_driver.planning.opening_path import ToolPoses, opening_poses

FOLLOW_TOLERANCE = 0.003
"""Pose error at which a path of tool poses counts as lost [m, a radian of tilt as 0.1 m]: the cup's
lip takes up a few millimetres."""
_GOALS = 8
"""Standoff configurations that are kept as goals [-]: the path search tries the straight way to
each, and more of them rarely differ."""
_CANDIDATES = 24
"""Branches that are compared without margins [-]: each costs a collision check per pose."""
_ROOM_FACTORS = (4.0, 2.0, 1.0)
"""Multiples of the scene margin to try, widest first [-]."""
_ENOUGH_ROOM = 0.3
"""Distance to the joint limits beyond which more does not count [rad]."""
_TRAVEL_WEIGHT = 0.2
"""Joint margin that a radian of travel to the standoff is worth [rad/rad]."""


@dataclass(frozen=True)
class Standoffs:
    """Configurations at the standoff, best first, or why there are none.

    Attributes:
        reason: REACHED if there are any, otherwise why not.
        message: For people.
        configurations: (G, J) [rad].
        reach: Part of the opening that can be followed from the best of them, 0..1.
    """

    reason: MotionReason
    message: str
    configurations: Array
    reach: float = 0.0


class StandoffSearch:
    """Find configurations at the standoff by inverse kinematics from many seeds.

    Args:
        kinematics: The arm.
        collision: Robot and scene; its boxes and margin are as before after every call.
        box: Joint limits with their margin.
        params: Parameters of the motion core.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        collision: CollisionChecker,
        box: PositionBox,
        params: MotionParams,
    ) -> None:
        self._kinematics, self._collision = kinematics, collision
        self._box, self._params = box, params

    def best(
        self,
        side: int,
        start: Array,
        contact: Array,
        direction: Array,
        joint: JointEstimate | None,
        part: Box | None,
        rng: np.random.Generator,
    ) -> Standoffs:
        """Return the configurations of the first tilt of the tool that has any, straight first.

        Without any, the reason that kept the straight tool away is the better explanation.
        """
        planning = self._params.planning
        slack = planning.tilt_slack if side > 0 else self._params.flow_step.push_lag
        straight: Standoffs | None = None
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
            found = self._from_tilt(start, poses, part, rng)
            if len(found.configurations):
                return found
            straight = straight or found
        if straight is None:
            raise RuntimeError("no tilt was tried")
        return straight

    def _from_tilt(
        self, start: Array, poses: ToolPoses, part: Box | None, rng: np.random.Generator
    ) -> Standoffs:
        """Return free standoff configurations from which the contact is reached, best first."""
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
            return Standoffs(MotionReason.UNREACHABLE, self._out_of_reach(poses, 0), none)
        path = follow(self._kinematics, self._box, found, poses.positions, poses.axes)
        bad = path.error > FOLLOW_TOLERANCE
        reach = np.where(bad.any(axis=1), bad.argmax(axis=1), len(poses.positions))
        if reach.max() <= poses.contact:
            return Standoffs(MotionReason.UNREACHABLE, self._out_of_reach(poses, 1), none)
        free, touched = self._roomy_branches(path.positions, reach, poses, part)
        if free.max() <= poses.contact:
            where = touched or "the arm with the scene"
            return Standoffs(MotionReason.COLLISION, f"at the contact touches: {where}", none)
        best = np.flatnonzero(free == free.max())
        # Roomy joints first, then the short way.
        room = np.minimum(path.margin[best, : free.max()].min(axis=1), _ENOUGH_ROOM)
        travel = np.abs(found[best] - start).max(axis=1)
        ranked = best[np.argsort(_TRAVEL_WEIGHT * travel - room)]
        if free.max() < len(poses.positions):
            ranked = self._least_blocked(ranked[:_CANDIDATES], path.positions, reach, poses, part)
        total = poses.opened - poses.contact
        followed = 1.0 if total == 0 else (free.max() - 1 - poses.contact) / total
        return Standoffs(
            MotionReason.REACHED, "", found[ranked[:_GOALS]], min(1.0, float(followed))
        )

    def _roomy_branches(
        self, paths: Array, reach: Array, poses: ToolPoses, part: Box | None
    ) -> tuple[Array, str]:
        """Return how many poses of each branch are free, and the first contact found, in words.

        With more room than needed, if some branch has it over the whole opening.
        """
        free, touched = np.zeros(len(paths), dtype=int), ""
        usual = self._collision.scene_margin
        for factor in _ROOM_FACTORS:
            free, touched = np.zeros(len(paths), dtype=int), ""
            with self._collision.with_scene_margin(factor * usual):
                for i in np.argsort(-reach, kind="stable"):
                    if reach[i] <= max(poses.contact, free.max() - 1):
                        break
                    free[i], touch = self._free_poses(paths[i, : reach[i]], poses, part)
                    touched = touched or touch
            if free.max() == len(poses.positions):
                break
        return free, touched

    def _least_blocked(
        self,
        ranked: NDArray[np.intp],
        paths: Array,
        reach: Array,
        poses: ToolPoses,
        part: Box | None,
    ) -> NDArray[np.intp]:
        """Return the branches that get farthest without any margin.

        Margins are conservative. Where they block the opening, flow steps continue all the same,
        and branches differ in what they then really touch.
        """
        with self._collision.with_scene_margin(0.0):
            counts = [self._free_poses(paths[i, : reach[i]], poses, part)[0] for i in ranked]
        return np.array([i for i, n in zip(ranked, counts, strict=True) if n == max(counts)])

    def _free_poses(self, path: Array, poses: ToolPoses, part: Box | None) -> tuple[int, str]:
        """Return how many configurations are free, and what touches at the next one, in words.

        The cup may touch once it has left the standoff.
        """
        for k, q in enumerate(path):
            if part is not None:
                self._collision.move_box(part.name, poses.part[k] @ part.pose)
            touch = self._collision.touch(q, contact_links=() if k == 0 else TOOL_LINKS)
            if touch is not None:
                return k, str(touch)
        return len(path), ""

    def _out_of_reach(self, poses: ToolPoses, stage: int) -> str:
        where = "standoff" if stage == 0 else "contact"
        index = 0 if stage == 0 else poses.contact
        position = np.round(poses.positions[index], 3).tolist()
        axis = np.round(poses.axes[index], 2).tolist()
        return (
            f"no joint configuration takes the cup to the {where} {position} m with the tool along "
            f"{axis}; move the object nearer to the arm or turn it"
        )


def _tilts(direction: Array, slack: float) -> list[Array]:
    """Return (3, 3) turns of the tool to try: none, then by `slack` [rad] to four sides."""
    tilts = [np.eye(3)]
    if slack > 0:
        side = np.eye(3)[int(np.argmin(np.abs(direction)))]
        first = unit(np.cross(direction, side))
        for axis in (first, np.cross(direction, first)):
            tilts += [rotation_about(axis, slack), rotation_about(axis, -slack)]
    return tilts
