"""Calibration from the arm's own shape: what moves in the pictures must lie on the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.motion import joint_order
from flowbothd_common.types import Array, Cloud
from flowbothd_perception.calibration.captures import Capture
from flowbothd_perception.calibration.pose import Calibration, difference, twisted
from flowbothd_perception.crop import to_base
from flowbothd_perception.depth import ray_table
from flowbothd_perception.frame import DepthFrame, Optics
from flowbothd_perception.outliers import on_surface
from flowbothd_perception.params import OutlierParams
from flowbothd_perception.robot_filter import RobotFilter

_POINTS = 4000
"""Points kept of every arm pose."""

_AHEAD = 0.03
"""What is nearer by this [m] than the background has moved."""

_STEP = 3e-4
"""Of numerical derivatives [m, rad]."""

_STARTS = 30
"""Places from which the pose is looked for, around the guess."""

_START_SHIFT, _START_TURN = 0.06, 0.09
"""How far they scatter (standard deviations in each axis) [m, rad]."""

_FOUND = 0.004
"""Median distance of the moving points that no wrong pose reaches; hulls allow no less [m]."""

_FEWEST = 60
"""Points of the tool below which a pose says nothing of it."""


@dataclass(frozen=True)
class Stage:
    """One round of fitting.

    Attributes:
        gate: Points farther from the robot than this are left out [m].
        scale: Distances beyond this count less than by their square [m].
        tool_only: Use only points nearest to the tool, whose shape is known exactly; the arm's
            meshes are hulls, millimetres too large.

        points: Drawn from every arm pose.
        rounds: Most evaluations of the fit.
    """

    gate: float
    scale: float
    tool_only: bool = False
    points: int = 80
    rounds: int = 15


STAGES = (
    Stage(np.inf, 0.03, points=60, rounds=12),
    Stage(0.06, 0.01),
    Stage(0.03, 0.005),
    Stage(0.015, 0.003, tool_only=True, points=400),
    Stage(0.008, 0.002, tool_only=True, points=400),
)
"""From wide to narrow gates [m]: the first finds the arm, the last two refine the tool alone."""


def moving_points(captures: Sequence[Capture], rng: np.random.Generator) -> list[Cloud]:
    """(N, 3) points of each capture that are nearer than what is seen there otherwise.

    Everything else must stand still between the captures: then only the robot moves.

    Raises:
        InvalidCloudError: fewer than three captures, or cameras that differ.
    """
    if len(captures) < 3:
        raise InvalidCloudError(
            "too few arm poses to tell the robot from the background",
            got=len(captures),
            allowed="at least 3, better 8 or more",
        )
    if len({capture.lens for capture in captures}) > 1:
        raise InvalidCloudError("captures of different cameras cannot be mixed")
    optics = Optics(ray_table(captures[0].lens))
    metres = np.stack([_metres(capture.depth) for capture in captures])
    known = np.isfinite(metres)
    # Where most pictures show nothing at all, nothing is what the background is.
    background = np.where(known, metres, 0).max(axis=0)
    background[known.sum(axis=0) <= len(captures) // 2] = np.inf
    clouds = []
    for depth in metres:
        pixels = np.flatnonzero(np.isfinite(depth) & (depth < background - _AHEAD))
        frame = DepthFrame(np.where(np.isfinite(depth), depth, np.float32(0)), optics)
        image, unit, where, pitch = frame.grid(pixels)
        pixels = pixels[on_surface(image, unit, where, pitch, OutlierParams())]
        chosen = rng.choice(pixels, min(len(pixels), _POINTS), replace=False)
        clouds.append(frame.points(np.sort(chosen)))
    return clouds


def fit_robot(
    robot: RobotFilter,
    tool_links: Sequence[str],
    captures: Sequence[Capture],
    guess: Array,
    clouds: Sequence[Cloud] | None = None,
    stages: Sequence[Stage] = STAGES,
    seed: int = 0,
) -> Calibration:
    """Camera pose with which the moving points lie on the robot's surface.

    Args:
        robot: Without any padding.
        tool_links: Links of exactly known shape.
        captures: At least 3 arm poses; 8 or more, with the tool in different places, are good.
        guess: (4, 4) T_base_camera, right within some 15 cm and 15 degrees.
        clouds: Points of each capture that are taken for the robot's; `moving_points` if omitted.
        stages: From coarse to fine.
        seed: Of the choice of points.

    Raises:
        InvalidCloudError: too few captures, or too little of the robot is seen.
    """
    rng = np.random.default_rng(seed)
    seen = list(moving_points(captures, rng) if clouds is None else clouds)
    joints = [c.joint_positions[joint_order(robot.joint_names, c.joint_names)] for c in captures]
    fit = _Fit(robot, frozenset(tool_links), seen, joints, rng)
    pose = fit.search(guess, stages[:2])
    for stage in stages[1:]:
        pose = fit.refine(pose, stage)
    last = fit.chosen(pose, stages[-1])
    residuals = [
        fit.distances(pose, i, points, stages[-1]) for i, points in enumerate(last) if len(points)
    ]
    if not residuals:
        raise InvalidCloudError("the robot is not seen where the guess says; check the guess")
    spreads = [difference(pose, other) for other in fit.leaving_one_out(pose, stages[-1])]
    return Calibration(
        pose,
        _rms(np.concatenate(residuals)),
        max(map(_rms, residuals)),
        max((d for d, _ in spreads), default=float("nan")),
        max((a for _, a in spreads), default=float("nan")),
        len(residuals),
        sum(map(len, residuals)),
    )


class _Fit:
    """Least squares of distances to the robot's surface."""

    def __init__(
        self,
        robot: RobotFilter,
        tool: frozenset[str],
        clouds: Sequence[Cloud],
        joints: Sequence[Array],
        rng: np.random.Generator,
    ) -> None:
        self._robot, self._tool = robot, tool
        self._clouds, self._joints, self._rng = clouds, joints, rng
        self._is_tool = np.array([link in tool for link in robot.links])

    def search(self, guess: Array, stages: Sequence[Stage]) -> Array:
        """The pose from which the fine stages can start.

        A shape seen from one side fits itself in wrong places too; those leave larger distances.
        """
        some = [cloud[self._rng.permutation(len(cloud))[:150]] for cloud in self._clouds]
        pivot = np.concatenate([to_base(guess, c) for c in some]).mean(axis=0).astype(float)
        best, smallest = guess, np.inf
        for start in range(_STARTS):
            change = self._rng.normal(size=6) * np.repeat([_START_SHIFT, _START_TURN], 3)
            pose = guess if start == 0 else twisted(change, pivot) @ guess
            for stage in stages:
                pose = self.refine(pose, stage)
            left = [self.distances(pose, i, c, stages[0]) for i, c in enumerate(some)]
            median = float(np.median(np.abs(np.concatenate(left))))
            if median < smallest:
                best, smallest = pose, median
            if smallest < _FOUND:
                break
        return best

    def chosen(self, pose: Array, stage: Stage) -> list[Cloud]:
        """Points of each capture that the stage uses, given the pose so far."""
        result = []
        for cloud, joints in zip(self._clouds, self._joints, strict=True):
            distance, part = self._robot.distances(to_base(pose, cloud), joints)
            keep = np.abs(distance) < stage.gate
            if stage.tool_only:
                keep &= self._is_tool[part]
            points = cloud[keep]
            if stage.tool_only and len(points) < _FEWEST:
                points = points[:0]
            result.append(points[self._rng.permutation(len(points))[: stage.points]])
        return result

    def distances(self, pose: Array, index: int, points: Cloud, stage: Stage) -> Array:
        """(N,) signed distances to the stage's surface of points of one capture [m]."""
        links = self._tool if stage.tool_only else None
        base = to_base(pose, points)
        return self._robot.distances(base, self._joints[index], links)[0].astype(float)

    def refine(self, pose: Array, stage: Stage, leave_out: int = -1) -> Array:
        """The pose that fits best, starting from `pose`."""
        chosen = self.chosen(pose, stage)
        used = [i for i, points in enumerate(chosen) if len(points) and i != leave_out]
        if stage.tool_only and len(used) < 3:
            # Too little of the tool is seen: what the whole arm says has to do.
            return pose
        if not used:
            raise InvalidCloudError(
                "the robot is not seen where the guess says",
                got=f"{sum(map(len, self._clouds))} points that moved",
                hint="check the guess, and that only the arm moves between the captures",
            )
        pivot = np.concatenate([to_base(pose, chosen[i]) for i in used]).mean(axis=0).astype(float)

        def misses(change: NDArray[np.float64]) -> Array:
            now = twisted(change, pivot) @ pose
            return np.concatenate([self.distances(now, i, chosen[i], stage) for i in used])

        def slopes(change: NDArray[np.float64]) -> Array:
            # Points are float32: steps much smaller than these would be lost in rounding.
            here = misses(change)
            return np.stack(
                [(misses(change + step) - here) / _STEP for step in _STEP * np.eye(6)], axis=1
            )

        solution = least_squares(
            misses, np.zeros(6), slopes, loss="soft_l1", f_scale=stage.scale, max_nfev=stage.rounds
        )
        return np.asarray(twisted(solution.x, pivot) @ pose)

    def leaving_one_out(self, pose: Array, stage: Stage) -> list[Array]:
        """The pose without each capture in turn; their scatter is the uncertainty."""
        return [self.refine(pose, stage, leave_out=i) for i in range(len(self._clouds))]


def _metres(depth: NDArray[np.generic]) -> NDArray[np.float32]:
    """(H, W) depths [m], NaN where nothing was measured."""
    values = depth.astype(np.float32)
    if depth.dtype == np.uint16:
        values *= np.float32(0.001)
    return np.where((values > 0) & np.isfinite(values), values, np.float32(np.nan))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
