"""The whole way from measured points to the object cloud."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from flowbothd_common.types import Array, Cloud
from flowbothd_perception.crop import crop_to_base
from flowbothd_perception.outliers import inliers
from flowbothd_perception.params import PipelineParams
from flowbothd_perception.robot_filter import RobotFilter
from flowbothd_perception.sampling import sample


@dataclass(frozen=True)
class PerceptionResult:
    """The object cloud and how it came about.

    Attributes:
        points: (N, 3) float32 in base [m], finite; at most sampling.points, perhaps none.
        counts: Points left after each stage, in order.
        seconds: Time of each stage, steady clock.
        message: Empty, or what is odd.
    """

    points: Cloud
    counts: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    message: str = ""


class PerceptionPipeline:
    """Crop, robot filter, outlier removal and sampling, with fixed parameters.

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
        points_camera: Cloud,
        T_base_camera: Array,
        joint_positions: Sequence[float] | Array,
        seed: int | Sequence[int] = 0,
    ) -> PerceptionResult:
        """Turn one frame into the object cloud.

        Args:
            points_camera: (N, 3) float32 in the optical frame; points that are not finite are
                dropped, N may be 0.
            T_base_camera: (4, 4).
            joint_positions: (J,) at the time of the frame, in the order of `joint_names`.
            seed: Of the sampling: the same frame and seed give the same cloud.
        """
        params, rng = self._params, np.random.default_rng(seed)
        counts = {"measured": len(points_camera)}
        seconds: dict[str, float] = {}
        clock = time.perf_counter()

        def done(stage: str, cloud: Cloud) -> Cloud:
            nonlocal clock
            now = time.perf_counter()
            counts[stage], seconds[stage] = len(cloud), now - clock
            clock = now
            return cloud

        measured = np.asarray(points_camera, dtype=np.float32)
        cloud = done("workspace", crop_to_base(measured, T_base_camera, params.crop))
        cloud = done("robot", self._off_robot(cloud, joint_positions, rng))
        cloud = done("outliers", cloud[inliers(cloud, params.outliers)])
        cloud = done("sampled", np.ascontiguousarray(sample(cloud, params.sampling.points, rng)))
        return PerceptionResult(cloud, counts, seconds, self._remark(counts))

    def _off_robot(
        self, cloud: Cloud, joint_positions: Sequence[float] | Array, rng: np.random.Generator
    ) -> Cloud:
        """Points that are not the robot's, drawn at random until there are plenty.

        A frame has thirty times the points that the object cloud keeps; filtering them all would
        take thirty times as long for the same outcome.
        """
        wanted = self._params.outliers.candidates
        order = rng.permutation(len(cloud))
        kept: list[Cloud] = []
        for begin in range(0, len(order), wanted):
            chunk = cloud[order[begin : begin + wanted]]
            kept.append(chunk[~self._robot.on_robot(chunk, joint_positions)])
            if sum(map(len, kept)) >= wanted // 2:
                break
        return np.concatenate(kept) if kept else cloud[:0]

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
