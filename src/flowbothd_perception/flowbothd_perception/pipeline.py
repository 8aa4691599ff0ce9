"""All stages from a frame to the object cloud."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.types import Array, Cloud
from flowbothd_perception.crop import to_base
from flowbothd_perception.frame import CloudFrame, Frame, Indices
from flowbothd_perception.outliers import beside, inliers, on_surface
from flowbothd_perception.params import PipelineParams
from flowbothd_perception.robot_filter import RobotFilter
from flowbothd_perception.sampling import sample

_Mask = NDArray[np.bool_]


class Verdict(IntEnum):
    """Class that a pixel was assigned to."""

    OUTSIDE = 0
    """Nothing measured, or outside the workspace."""
    ROBOT = 1
    OUTLIER = 2
    OBJECT = 3


@dataclass(frozen=True)
class PerceptionResult:
    """The object cloud and how it came about.

    Attributes:
        points: (N, 3) float32 in base [m], finite; at most sampling.points, perhaps none.
        pixels: (N,) which pixel of the frame, counted row by row, each point is.
        counts: Points left after each stage, in order; of the drawn ones after the workspace.
        seconds: Time of each stage, steady clock.
        message: Empty, or what is odd.
        verdicts: (H, W) uint8 `Verdict` of every pixel, if asked for.
    """

    points: Cloud
    pixels: Indices
    counts: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    message: str = ""
    verdicts: NDArray[np.uint8] | None = None


class PerceptionPipeline:
    """Crop, robot filter, outlier removal and sampling, with fixed parameters.

    A frame has a hundred times the points that the object cloud keeps. Cropping and looking at
    neighbours happens on the frame's pixels; everything that costs more is done for pixels drawn
    at random, until there are enough.

    Args:
        params: Of all stages.
        urdf: Text of the robot description.

    Raises:
        ObjectModelError: the description cannot be used.
        ParameterError: parameters name links that it does not have.
    """

    def __init__(self, params: PipelineParams, urdf: str) -> None:
        self._params = params
        self._robot = RobotFilter(urdf, params.robot)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints whose positions `process` wants, in order."""
        return self._robot.joint_names

    def process(
        self,
        frame: Frame | Cloud,
        T_base_camera: Array,
        joint_positions: Sequence[float] | Array,
        seed: int | Sequence[int] = 0,
        *,
        whole: bool = False,
    ) -> PerceptionResult:
        """Turn one frame into the object cloud.

        Args:
            frame: A DepthFrame or CloudFrame, or an array for the latter: (H, W, 3) or (N, 3)
                float32 in the optical frame. It may be empty.
            T_base_camera: (4, 4).
            joint_positions: (J,) at the time of the frame, in the order of `joint_names`.
            seed: Of the sampling: the same frame and seed give the same cloud.
            whole: Judge every pixel (for pictures and organised output), not only enough of them.
        """
        if isinstance(frame, np.ndarray):
            frame = CloudFrame(frame)
        steps = _Steps({"measured": frame.measured()})
        rng = np.random.default_rng(seed)
        pixels = frame.inside(T_base_camera, self._params.crop)
        steps.done("workspace", len(pixels))
        look = _Look(frame, pixels, T_base_camera, joint_positions)
        pixels, points = self._off_robot(look, pixels, rng, steps)
        keep = inliers(points, self._params.outliers)
        pixels, points = pixels[keep], points[keep]
        steps.done("outliers", len(points))
        verdicts = self._verdicts(look, points) if whole else None
        chosen = sample(len(points), self._params.sampling.points, rng)
        pixels, points = pixels[chosen], points[chosen]
        steps.done("sampled", len(points))
        return PerceptionResult(
            points, pixels, steps.counts, steps.seconds, self._remark(steps.counts), verdicts
        )

    def _judge(self, look: _Look, at: NDArray[np.intp]) -> tuple[Cloud, _Mask, _Mask]:
        """Points in base of some of the workspace's pixels; who is robot's, who is on a surface."""
        points = to_base(look.T_base_camera, look.frame.points(look.pixels[at]))
        on_robot = self._robot.on_robot(points, look.joint_positions, look.T_base_camera[:3, 3])
        steady = np.zeros(len(at), dtype=bool)
        free = np.flatnonzero(~on_robot)
        depth, unit, where, pitch = look.grid
        steady[free] = on_surface(depth, unit, where[at[free]], pitch, self._params.outliers)
        return points, on_robot, steady

    def _off_robot(
        self, look: _Look, pixels: Indices, rng: np.random.Generator, steps: _Steps
    ) -> tuple[Indices, Cloud]:
        """Pixels on surfaces that are not the robot's, drawn at random until there are plenty."""
        wanted = max(self._params.outliers.candidates, self._params.sampling.points)
        order = rng.permutation(len(pixels))
        kept: list[tuple[Indices, Cloud]] = []
        drawn = robot = found = 0
        more = wanted + wanted // 2
        while drawn < len(order) and found < wanted:
            at = order[drawn : drawn + more]
            points, on_robot, steady = self._judge(look, at)
            drawn, robot = drawn + len(at), robot + int(on_robot.sum())
            found += int(steady.sum())
            # A tenth more than the share found so far lets expect.
            more = int(1.1 * (wanted - found) * drawn / max(found, drawn // 20, 1)) + 100
            kept.append((pixels[at[steady]], points[steady]))
        steps.counts["drawn"] = drawn
        steps.counts["robot"] = drawn - robot
        steps.done("surface", found)
        if not kept:
            return pixels[:0], np.empty((0, 3), dtype=np.float32)
        return (
            np.concatenate([p for p, _ in kept])[:wanted],
            np.concatenate([c for _, c in kept])[:wanted],
        )

    def _verdicts(self, look: _Look, inlying: Cloud) -> NDArray[np.uint8]:
        """(H, W) what every pixel is; stragglers are what lies far from all inlying points."""
        points, on_robot, steady = self._judge(look, np.arange(len(look.pixels)))
        cluster = self._params.outliers.cluster_tolerance
        if cluster > 0:
            steady &= beside(points, inlying, cluster)
        result = np.zeros(look.frame.shape, dtype=np.uint8)
        result.reshape(-1)[look.pixels] = np.where(
            on_robot, Verdict.ROBOT, np.where(steady, Verdict.OBJECT, Verdict.OUTLIER)
        )
        return result

    def _remark(self, counts: dict[str, int]) -> str:
        if not counts["measured"]:
            return "the camera measured nothing"
        if not counts["workspace"]:
            low, high = self._params.crop.min_corner, self._params.crop.max_corner
            return (
                f"none of {counts['measured']} points lies in the workspace {low} .. {high}; "
                "check camera.position, camera.quaternion and crop"
            )
        if not counts["robot"]:
            return "only the robot is in view"
        if counts["sampled"] < self._params.sampling.points:
            return f"only {counts['sampled']} of {self._params.sampling.points} points are in view"
        return ""


class _Look:
    """One frame while it is worked on.

    Attributes:
        frame: The frame.
        pixels: Of the workspace.
        T_base_camera: (4, 4).
        joint_positions: Of the robot.
    """

    def __init__(
        self,
        frame: Frame,
        pixels: Indices,
        T_base_camera: Array,
        joint_positions: Sequence[float] | Array,
    ) -> None:
        self.frame, self.pixels = frame, pixels
        self.T_base_camera, self.joint_positions = T_base_camera, joint_positions
        self.grid = frame.grid(pixels)


class _Steps:
    """Counts and timings of the stages."""

    def __init__(self, counts: dict[str, int]) -> None:
        self.counts, self.seconds = counts, dict[str, float]()
        self.clock = time.perf_counter()

    def done(self, stage: str, left: int) -> None:
        """Note the end of a stage and how many it left."""
        now = time.perf_counter()
        self.counts[stage], self.seconds[stage] = left, now - self.clock
        self.clock = now
