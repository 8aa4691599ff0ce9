"""A depth camera: rays through every pixel into persistent scenes, one per rigid part."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import FlowBotError
from flowbothd_common.transforms import apply, inverse
from flowbothd_common.types import Array, Cloud
from sim_bridge.depth_noise import DepthNoise, disturb
from sim_bridge.scene import Part, ray_scene, tensor


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion; pixel (u, v) looks along ((u-cx)/fx, (v-cy)/fy, 1).

    Attributes:
        width: [pixels].
        height: [pixels].
        fx: [pixels].
        fy: [pixels].
        cx: Centre [pixels]; whole numbers are pixel centres.
        cy: Centre [pixels].
        near: Nearer surfaces are not measured (z) [m].
        far: Farther surfaces are not measured (z) [m].
    """

    width: int = 640
    height: int = 576
    fx: float = 504.0
    fy: float = 504.0
    cx: float = 319.5
    cy: float = 287.5
    near: float = 0.25
    far: float = 3.86

    def __post_init__(self) -> None:
        """Reject sizes that cannot be rendered."""
        if min(self.width, self.height) < 1 or min(self.fx, self.fy) <= 0:
            raise FlowBotError(
                "camera intrinsics",
                got=f"{self.width} x {self.height}, fx {self.fx}, fy {self.fy}",
                allowed="positive sizes and focal lengths",
            )

    def directions(self) -> NDArray[np.float32]:
        """(H, W, 3) directions with z = 1 in the optical frame."""
        u = (np.arange(self.width, dtype=np.float64) - self.cx) / self.fx
        v = (np.arange(self.height, dtype=np.float64) - self.cy) / self.fy
        grid = np.ones((self.height, self.width, 3), dtype=np.float32)
        grid[..., 0] = u[None, :]
        grid[..., 1] = v[:, None]
        return grid


AZURE_KINECT_NFOV = Intrinsics()
"""Like an Azure Kinect, NFOV unbinned, undistorted."""

PAPER_CAMERA = Intrinsics(640, 480, 450.0, 450.0, 319.5, 239.5, near=0.01, far=10.0)
"""The camera of the paper's evaluation."""


@dataclass(frozen=True)
class DepthImage:
    """One frame.

    Attributes:
        depth: (H, W) float32 z [m]; 0 = nothing measured.
        labels: (H, W) int16 index into `names`; -1 = nothing.
        names: Of the parts.
    """

    depth: NDArray[np.float32]
    labels: NDArray[np.int16]
    names: tuple[str, ...]

    def millimetres(self) -> NDArray[np.uint16]:
        """(H, W) uint16 [mm], 0 = invalid (REP-118)."""
        return np.asarray(np.rint(self.depth * 1000.0), dtype=np.uint16)

    def mask(self, prefix: str) -> NDArray[np.bool_]:
        """(H, W) whether a pixel shows a part whose name starts with `prefix`."""
        wanted = [i for i, name in enumerate(self.names) if name.startswith(prefix)]
        return np.isin(self.labels, wanted)


@dataclass(frozen=True)
class _View:
    """The last picture of one part: its pose, its rectangle, its depths."""

    pose: Array
    rows: slice
    columns: slice
    depth: NDArray[np.float32]


class DepthCamera:
    """Renders z-depth of rigid parts.

    Each part's acceleration structure is built once, in the part's own frame; per frame only rays
    inside its projected bounding box are cast, and only if the part has moved since the last frame.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        T_base_camera: Array,
        intrinsics: Intrinsics = AZURE_KINECT_NFOV,
        noise: DepthNoise | None = None,
        seed: int = 0,
    ) -> None:
        """Build the scenes.

        Args:
            parts: What can be seen.
            T_base_camera: (4, 4) pose of the optical frame (z forward, x right, y down).
            intrinsics: The lens.
            noise: Of the depths; None for exact ones.
            seed: Of the noise.
        """
        self.intrinsics = intrinsics
        self.noise = noise
        self._rng = np.random.default_rng(seed)
        self._directions = intrinsics.directions()
        self.T_base_camera = np.array(T_base_camera, dtype=float)
        self.set_parts(parts)

    def set_parts(self, parts: Sequence[Part]) -> None:
        """Look at other parts; scenes of parts that stay (same object) are kept."""
        old = {id(part): scene for part, scene in getattr(self, "_scenes", [])}
        self._scenes = [
            (part, old.get(id(part)) or ray_scene(part.mesh))
            for part in parts
            if any(len(mesh.faces) for mesh in part.meshes)
        ]
        self.names = tuple(part.name for part, _ in self._scenes)
        self._corners = [_box_corners(part.mesh.vertices) for part, _ in self._scenes]
        self._views: list[_View | None] = [None] * len(self._scenes)

    def seed(self, seed: int) -> None:
        """Restart the noise."""
        self._rng = np.random.default_rng(seed)

    def render(self, poses: Mapping[str, Array]) -> DepthImage:
        """Take a picture.

        Args:
            poses: (4, 4) T_base_part by name; parts without a pose are not there.
        """
        exposure = self.exposing(poses)
        while True:
            try:
                next(exposure)
            except StopIteration as done:
                image: DepthImage = done.value
                return image

    def exposing(self, poses: Mapping[str, Array]) -> Generator[None, None, DepthImage]:
        """Take a picture in small pieces of work, with a yield after each; returns the image.

        Ray casting does not let other threads run: who has something else to do meanwhile does it
        between the pieces. The picture shows the poses as given, however long it takes.
        """
        size = (self.intrinsics.height, self.intrinsics.width)
        depth = np.full(size, np.inf, dtype=np.float32)
        labels = np.full(size, -1, dtype=np.int16)
        to_camera = inverse(self.T_base_camera)
        for index, name in enumerate(self.names):
            if name not in poses:
                continue
            view = self._update(index, to_camera @ poses[name])
            window = depth[view.rows, view.columns]
            nearer = view.depth < window
            window[nearer] = view.depth[nearer]
            labels[view.rows, view.columns][nearer] = index
            yield
        if self.noise is not None:
            depth = disturb(depth, self.noise, self._rng)
        measured = (depth >= self.intrinsics.near) & (depth <= self.intrinsics.far)
        return DepthImage(
            np.where(measured, depth, np.float32(0)),
            np.where(measured, labels, np.int16(-1)),
            self.names,
        )

    def cloud(self, image: DepthImage, mask: NDArray[np.bool_] | None = None) -> Cloud:
        """(N, 3) float32 points in base of all measured pixels (of those in the (H, W) mask)."""
        valid = image.depth > 0 if mask is None else (image.depth > 0) & mask
        points = self._directions[valid] * image.depth[valid][:, None]
        rotation, eye = self.T_base_camera[:3, :3], self.T_base_camera[:3, 3]
        return np.asarray(points @ rotation.T.astype(np.float32) + eye, dtype=np.float32)

    def _update(self, index: int, pose: Array) -> _View:
        view = self._views[index]
        if view is not None and np.array_equal(view.pose, pose):
            return view
        rows, columns = self._rectangle(apply(pose, self._corners[index]))
        part_from_camera = inverse(pose)
        directions = self._directions[rows, columns]
        rays = np.empty((*directions.shape[:2], 6), dtype=np.float32)
        rays[..., :3] = part_from_camera[:3, 3]
        np.matmul(directions, part_from_camera[:3, :3].T.astype(np.float32), out=rays[..., 3:])
        # The directions have z = 1 in the camera and keep their length: t_hit IS the z-depth.
        scene = self._scenes[index][1]
        hit = scene.cast_rays(tensor(rays), nthreads=1)["t_hit"].numpy()
        view = self._views[index] = _View(pose, rows, columns, hit)
        return view

    def _rectangle(self, corners: Array) -> tuple[slice, slice]:
        """Pixels that a part may cover, from its box corners (8, 3) in the camera frame."""
        lens = self.intrinsics
        if corners[:, 2].max() <= lens.near:
            return slice(0, 0), slice(0, 0)
        if corners[:, 2].min() <= 0.5 * lens.near:
            # Part of it is behind the image plane, where a projection means nothing.
            return slice(0, lens.height), slice(0, lens.width)
        u = corners[:, 0] / corners[:, 2] * lens.fx + lens.cx
        v = corners[:, 1] / corners[:, 2] * lens.fy + lens.cy
        left, right = np.floor(u.min()) - 1, np.ceil(u.max()) + 2
        top, bottom = np.floor(v.min()) - 1, np.ceil(v.max()) + 2
        columns = np.clip([left, right], 0, lens.width).astype(int)
        rows = np.clip([top, bottom], 0, lens.height).astype(int)
        return slice(rows[0], rows[1]), slice(columns[0], columns[1])


def _box_corners(vertices: Array) -> Array:
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    picks = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)], dtype=bool)
    return np.asarray(np.where(picks, high, low))
