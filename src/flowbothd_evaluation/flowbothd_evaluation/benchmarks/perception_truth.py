"""How much of the robot goes and how much of the object stays: every pixel against the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.transforms import rotation_about, transform
from flowbothd_common.types import Array
from flowbothd_evaluation.benchmarks.perception_scenes import OBJECT, ROBOT, TruthFrame
from flowbothd_perception.crop import inside_box
from flowbothd_perception.frame import CloudFrame, DepthFrame, Frame, Optics
from flowbothd_perception.params import PipelineParams
from flowbothd_perception.pipeline import PerceptionPipeline, Verdict

KINDS = ("depth", "cloud", "loose")
"""Forms in which frames are given: 16 bit depth, organised cloud, valid points alone."""


@dataclass
class Tally:
    """Pixels counted over many frames.

    Attributes:
        robot: Of the robot, measured.
        robot_left: Of those, what crop and body filter leave.
        object: Of the object, truly within the workspace.
        object_taken: Of those, what the body filter takes for the robot.
        object_lost: Of those, what crop and body filter lose.
        flying: Flying pixels that crop and body filter leave.
        flying_left: Of those, what the outlier stage leaves.
        surface: Object pixels that reach the outlier stage.
        surface_lost: Of those, what the outlier stage removes.
    """

    robot: int = 0
    robot_left: int = 0
    object: int = 0
    object_taken: int = 0
    object_lost: int = 0
    flying: int = 0
    flying_left: int = 0
    surface: int = 0
    surface_lost: int = 0

    def add(
        self, frame: TruthFrame, verdicts: NDArray[np.uint8], inside: NDArray[np.bool_]
    ) -> None:
        """Count one frame.

        Args:
            frame: The truth.
            verdicts: (H, W) of the pipeline.
            inside: (H, W) whether the pixel's true point lies in the workspace.
        """
        seen = frame.depth > 0
        left = (verdicts == Verdict.OBJECT) | (verdicts == Verdict.OUTLIER)
        robot = seen & (frame.owner == ROBOT) & ~frame.flying
        thing = seen & (frame.owner == OBJECT) & ~frame.flying & inside
        flying = frame.flying & left
        surface = thing & left
        counts = (
            ("robot", robot),
            ("robot_left", robot & left),
            ("object", thing),
            ("object_taken", thing & (verdicts == Verdict.ROBOT)),
            ("object_lost", thing & ~left),
            ("flying", flying),
            ("flying_left", flying & (verdicts == Verdict.OBJECT)),
            ("surface", surface),
            ("surface_lost", surface & (verdicts == Verdict.OUTLIER)),
        )
        for name, mask in counts:
            setattr(self, name, getattr(self, name) + int(np.count_nonzero(mask)))

    def shares(self) -> dict[str, float]:
        """The figures; NaN where nothing of the kind was seen."""
        return {
            "robot_removed": _share(self.robot_left, self.robot),
            "object_kept": _share(self.object_taken, self.object),
            "object_kept_with_crop": _share(self.object_lost, self.object),
            "flying_removed": _share(self.flying_left, self.flying),
            "surface_kept": _share(self.surface_lost, self.surface),
        }


def _share(part: int, whole: int) -> float:
    if not whole:
        return float("nan")
    return 1.0 - part / whole


@dataclass
class TruthReport:
    """Tallies in total, and by object and camera mount."""

    total: Tally = field(default_factory=Tally)
    by_object: dict[str, Tally] = field(default_factory=dict)
    by_mount: dict[str, Tally] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Shares and counts for a file."""
        return {
            "total": {**self.total.shares(), **asdict(self.total)},
            "by_object": {name: tally.shares() for name, tally in self.by_object.items()},
            "by_mount": {name: tally.shares() for name, tally in self.by_mount.items()},
        }

    def add(
        self, frame: TruthFrame, verdicts: NDArray[np.uint8], inside: NDArray[np.bool_]
    ) -> None:
        """Count one frame."""
        for tally in (
            self.total,
            self.by_object.setdefault(frame.name, Tally()),
            self.by_mount.setdefault(frame.mount.name, Tally()),
        ):
            tally.add(frame, verdicts, inside)


def displaced(
    T_base_camera: Array, rng: np.random.Generator, metres: float, degrees: float
) -> Array:
    """(4, 4) the camera's pose as a calibration would tell it that is wrong by exactly so much."""
    shift = rng.standard_normal(3)
    shift *= metres / np.linalg.norm(shift)
    turn = rotation_about(rng.standard_normal(3), np.radians(degrees))
    return np.asarray(T_base_camera @ transform(turn, shift))


class TruthCheck:
    """Runs frames through the pipeline and counts.

    Args:
        urdf: The robot description.
        directions: (H, W, 3) of the camera's pixels, z = 1.
        params: Of the pipeline.
        kind: One of KINDS.
    """

    def __init__(
        self,
        urdf: str,
        directions: NDArray[np.float32],
        params: PipelineParams | None = None,
        kind: str = "depth",
    ) -> None:
        self._params = params or PipelineParams()
        self._pipeline = PerceptionPipeline(self._params, urdf)
        self._directions = directions
        self._make: Callable[[NDArray[np.float32]], Frame] = {
            "depth": self._depth_frame,
            "cloud": self._cloud_frame,
            "loose": self._loose_frame,
        }[kind]
        self._optics = Optics(np.ascontiguousarray(directions[..., :2]))
        self._loose = kind == "loose"

    def count(self, frame: TruthFrame, T_base_camera: Array, report: TruthReport) -> None:
        """Count one frame, given what a calibration tells of the camera's pose."""
        report.add(frame, self.verdicts(frame, T_base_camera), self._inside(frame))

    def verdicts(self, frame: TruthFrame, T_base_camera: Array) -> NDArray[np.uint8]:
        """(H, W) what the pipeline takes every pixel for."""
        result = self._pipeline.process(
            self._make(frame.depth), T_base_camera, frame.joint_positions, whole=True
        ).verdicts
        shape = frame.depth.shape
        if not self._loose:
            return np.asarray(result).reshape(shape)
        spread = np.zeros(shape, dtype=np.uint8)
        spread[frame.depth > 0] = np.asarray(result).ravel()
        return spread

    def _inside(self, frame: TruthFrame) -> NDArray[np.bool_]:
        camera = frame.mount.T_base_camera
        points = (self._directions * frame.exact[..., None]).reshape(-1, 3).astype(float)
        base = (points @ camera[:3, :3].T + camera[:3, 3]).astype(np.float32)
        return np.asarray(inside_box(base, self._params.crop).reshape(frame.depth.shape))

    def _depth_frame(self, depth: NDArray[np.float32]) -> Frame:
        return DepthFrame(np.rint(1000.0 * depth).astype(np.uint16), self._optics)

    def _cloud_frame(self, depth: NDArray[np.float32]) -> Frame:
        measured = np.where(depth > 0, depth, np.float32(np.nan))
        return CloudFrame(self._directions * measured[..., None])

    def _loose_frame(self, depth: NDArray[np.float32]) -> Frame:
        valid = depth > 0
        return CloudFrame(self._directions[valid] * depth[valid][:, None])


def compare(
    frames: Iterable[TruthFrame],
    checks: Mapping[str, TruthCheck],
    metres: float = 0.0,
    degrees: float = 0.0,
    seed: int = 0,
) -> dict[str, TruthReport]:
    """Count frames in every form, seen by a camera whose calibration is wrong by so much."""
    rng, reports = np.random.default_rng(seed), {name: TruthReport() for name in checks}
    for frame in frames:
        told = frame.mount.T_base_camera
        if metres or degrees:
            told = displaced(told, rng, metres, degrees)
        for name, check in checks.items():
            check.count(frame, told, reports[name])
    return reports
