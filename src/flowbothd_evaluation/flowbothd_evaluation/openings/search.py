"""Search for poses: whole openings by kinematics and the object's true boxes, no simulation.

Many random places of the object and of the grasp are judged by the arm's best branch: does it
reach from the standoff over the contact to the end of the opening and back off, and with how much
room to joint limits, singularities and the object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flowbothd_common.errors import ParameterError
from flowbothd_common.transforms import apply, transform
from flowbothd_common.types import Array
from flowbothd_evaluation.openings.part import TruePart
from flowbothd_evaluation.openings.task import Opening
from franka_suction_driver.arm.kinematics import conditioning, make_kinematics
from franka_suction_driver.arm.limits import robot_limits
from franka_suction_driver.params import MotionParams
from franka_suction_driver.planning.collision import Box, CollisionChecker, Margins
from franka_suction_driver.planning.departure import TOOL_LINKS
from franka_suction_driver.planning.inverse_kinematics import follow, solve
from franka_suction_driver.planning.opening_path import ToolPoses, opening_poses
from franka_suction_driver.simulated import sim_motion_params

_X = (0.2, 0.85)
_Y = (-0.5, 0.5)
_TURN_DEG = 7.5
_BASE_RADIUS = 0.16
_IK_SEEDS = 40
_BRANCHES = 6
_TOLERANCE = 0.003
_CLEARANCES = (0.005, 0.015, 0.03, 0.05)
_GOOD_MARGIN = 0.4
_GOOD_CONDITIONING = 0.16
_EDGE = 0.03
_AHEAD = 0.03


@dataclass(frozen=True)
class Place:
    """A pose of the object and a grasp, with what the arm's best branch there is worth.

    Attributes:
        position: (x, y) of the object [m].
        yaw_deg: Its turn.
        grasp: See `Opening.grasp`.
        reached: Part of the poses from standoff to back off that are reached and free, 0..1.
        margin: Smallest distance to a joint limit [rad].
        conditioning: Smallest singular value of the tool's Jacobian [m/rad].
        clearance: Distance that the arm keeps from the object, of a few tried [m].
    """

    position: tuple[float, float]
    yaw_deg: float
    grasp: tuple[float, float]
    reached: float
    margin: float = 0.0
    conditioning: float = 0.0
    clearance: float = 0.0

    @property
    def score(self) -> float:
        """Higher is better; nothing makes up for an opening that is not reached."""
        if self.reached < 1:
            return self.reached
        room = min(self.margin / _GOOD_MARGIN, 1.0)
        bend = min(self.conditioning / _GOOD_CONDITIONING, 1.0)
        return 1.0 + min(room, bend) + 0.5 * (room + bend) + self.clearance / _CLEARANCES[-1]

    def of(self, opening: Opening) -> Opening:
        """The opening there."""
        return opening.standing(self.position, float(np.radians(self.yaw_deg)), self.grasp)


class PlaceSearch:
    """Draws and judges places of one opening.

    Args:
        opening: The task; of its pose only a pushed part's distance from the hinge is kept.
        params: Of the motion core; the simulation's if omitted.
    """

    def __init__(self, opening: Opening, params: MotionParams | None = None) -> None:
        self._opening = opening
        self._params = params = params or sim_motion_params()
        self._arm = make_kinematics(params)
        self._box = robot_limits(self._arm, params.robot).box(params.robot.position_margin)
        self._home = np.array(params.robot.start_positions)
        self._seeds = np.vstack(
            [self._home, self._box.sample(np.random.default_rng(0), _IK_SEEDS - 1)]
        )
        model = opening.model()
        self._moving = model.target.child
        self._shapes = [
            (name, mesh.vertices.min(axis=0), mesh.vertices.max(axis=0))
            for name, link in model.links.items()
            for mesh in link.meshes
        ]
        self._face = _graspable(opening)
        self._still = CollisionChecker(self._arm, Margins(), table_height=None)
        self._swung = CollisionChecker(self._arm, Margins())

    def best(self, count: int, seed: int, keep: int) -> list[Place]:
        """The best of `count` random places, best first."""
        rng = np.random.default_rng([seed, 9])
        places = [self.judge(*self._draw(rng)) for _ in range(count)]
        return sorted(places, key=lambda place: -place.score)[:keep]

    def judge(
        self, position: tuple[float, float], yaw_deg: float, grasp: tuple[float, float]
    ) -> Place:
        """What one place is worth."""
        nothing = Place(position, yaw_deg, grasp, 0.0)
        opening = nothing.of(self._opening)
        if self._stands_on_base(opening.T_base_object):
            return nothing
        part = TruePart(opening)
        try:
            contact = part.contact(np.zeros(2))
        except ParameterError:
            return nothing
        poses = self._poses(opening, part, contact)
        found = solve(self._arm, self._box, self._seeds, poses.positions[0], poses.axes[0])
        if not len(found):
            return nothing
        path = follow(self._arm, self._box, found, poses.positions, poses.axes)
        bad = path.error > _TOLERANCE
        reach = np.where(bad.any(axis=1), bad.argmax(axis=1), len(poses.positions))
        total = len(poses.positions)
        whole = np.flatnonzero(reach == total)
        if not len(whole):
            return Place(position, yaw_deg, grasp, 0.5 * float(reach.max()) / total)
        bends = conditioning(self._arm.tip(path.positions[whole])).min(axis=1)
        rooms = path.margin[whole].min(axis=1)
        ranked = np.argsort(-np.minimum(rooms / _GOOD_MARGIN, bends / _GOOD_CONDITIONING))
        best = Place(position, yaw_deg, grasp, 0.5)
        self._set_scene(opening.T_base_object)
        for i in ranked[:_BRANCHES]:
            clearance = self._clearance(path.positions[whole[i]], poses)
            if clearance > 0:
                place = Place(
                    position, yaw_deg, grasp, 1.0, float(rooms[i]), float(bends[i]), clearance
                )
                best = max(best, place, key=lambda p: p.score)
        return best

    def _draw(
        self, rng: np.random.Generator
    ) -> tuple[tuple[float, float], float, tuple[float, float]]:
        x, y = float(rng.uniform(*_X)), float(rng.uniform(*_Y))
        yaw = _TURN_DEG * int(rng.integers(0, round(360 / _TURN_DEG)))
        across, along = (float(v) for v in rng.uniform(*self._face))
        if self._opening.front:
            # How near the hinge a tool has to push is decided by the frame, not by the place.
            across = self._opening.grasp[0]
        return (round(x, 2), round(y, 2)), float(yaw), (round(across, 3), round(along, 3))

    def _poses(self, opening: Opening, part: TruePart, contact: Array) -> ToolPoses:
        step = self._params.flow_step
        return opening_poses(
            contact,
            part.flow(contact, 0.0),
            -1 if opening.front else 1,
            self._params.approach.standoff,
            part.way(contact, opening.goal),
            part.joint_in_base,
            back_off=self._params.approach.back_off,
            tilt_slack=step.push_lag if opening.front else 0.0,
            spacing=_AHEAD,
        )

    def _stands_on_base(self, pose: Array) -> bool:
        for _, low, high in self._shapes:
            corners = np.array([(x, y, 0.0) for x in (low[0], high[0]) for y in (low[1], high[1])])
            grid = np.concatenate([corners, corners.mean(axis=0)[None]])
            if np.linalg.norm(apply(pose, grid)[:, :2], axis=1).min() < _BASE_RADIUS:
                return True
        return False

    def _set_scene(self, pose: Array) -> None:
        boxes = [
            Box(f"{name} {k}", tuple(high - low), pose @ transform(translation=(low + high) / 2))
            for k, (name, low, high) in enumerate(self._shapes)
        ]
        moving = f"{self._moving} "
        self._parts = [box for box in boxes if box.name.startswith(moving)]
        self._still.set_boxes(box for box in boxes if not box.name.startswith(moving))
        self._swung.set_boxes(self._parts)

    def _clearance(self, path: Array, poses: ToolPoses) -> float:
        kept = 0.0
        for margin in _CLEARANCES:
            # What the cup holds may lie close before what stands still.
            beside = () if margin == _CLEARANCES[0] else TOOL_LINKS
            with self._still.with_scene_margin(margin), self._swung.with_scene_margin(margin):
                clear = self._still.free(self._home) and self._free(path, poses, beside)
            if not clear:
                break
            kept = margin
        return kept

    def _free(self, path: Array, poses: ToolPoses, beside: Sequence[str]) -> bool:
        for k, q in enumerate(path):
            for box in self._parts:
                self._swung.move_box(box.name, poses.part[k] @ box.pose)
            tool: Sequence[str] = () if k == 0 else TOOL_LINKS
            if not self._still.free(q, contact_links=beside):
                return False
            if not self._swung.free(q, contact_links=tool):
                return False
        return True


def _graspable(opening: Opening) -> tuple[Array, Array]:
    """Low and high grasp on the part, the cup well on it; of hinges the outer half."""
    low, high = TruePart(opening).face
    edge = np.array([_EDGE, _EDGE])
    low, high = low + edge, high - edge
    if opening.hinged:
        low = np.array([(low[0] + high[0]) / 2, low[1]])
    return low, high
