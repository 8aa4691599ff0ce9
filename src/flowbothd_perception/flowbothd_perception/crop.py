"""The workspace box."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.types import Array, Cloud
from flowbothd_perception.params import CropParams


def to_base(T_base_camera: Array, points: Cloud) -> Cloud:
    """(N, 3) float32 points of the optical frame in base."""
    matrix = T_base_camera.astype(np.float32)
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3], dtype=np.float32)


def inside_box(points: Cloud, params: CropParams) -> NDArray[np.bool_]:
    """(N,) whether each point (in base) lies in the box; points that are not finite do not."""
    keep = np.ones(len(points), dtype=bool)
    for axis, (low, high) in enumerate(zip(params.min_corner, params.max_corner, strict=True)):
        keep &= (points[:, axis] >= np.float32(low)) & (points[:, axis] <= np.float32(high))
    return keep


class DepthCrop:
    """The box as an interval of depth for every pixel of a camera that stands still.

    Where a ray enters the box and where it leaves it depends on nothing that was measured: a frame
    is cropped by two comparisons a pixel, before any point is computed.

    Args:
        rays: (P, 2) x/z and y/z of every pixel; NaN where there is none.
        T_base_camera: (4, 4).
        params: The box.
        max_depth: Farther depths do not count [m].
    """

    def __init__(
        self,
        rays: NDArray[np.float32],
        T_base_camera: Array,
        params: CropParams,
        max_depth: float = np.inf,
    ) -> None:
        directions = np.column_stack([rays.astype(float), np.ones(len(rays))])
        slopes = directions @ T_base_camera[:3, :3].T
        # Smallest positive depth: zero means that nothing was measured.
        near, far = np.full(len(rays), 1e-6), np.full(len(rays), min(max_depth, 1e6))
        for axis in range(3):
            eye, slope = T_base_camera[axis, 3], slopes[:, axis]
            with np.errstate(divide="ignore", invalid="ignore"):
                a = (params.min_corner[axis] - eye) / slope
                b = (params.max_corner[axis] - eye) / slope
            parallel = slope == 0.0
            if parallel.any():
                within = params.min_corner[axis] <= eye <= params.max_corner[axis]
                a[parallel], b[parallel] = (-np.inf, np.inf) if within else (np.inf, np.inf)
            near = np.maximum(near, np.minimum(a, b))
            far = np.minimum(far, np.maximum(a, b))
        empty = ~(near <= far)
        near[empty], far[empty] = np.inf, 0.0
        self._metres = near.astype(np.float32), far.astype(np.float32)
        # An empty interval stays empty: 65535 .. 0.
        self._millimetres = (
            np.ceil(np.minimum(1000.0 * near, 65535.0)).astype(np.uint16),
            np.floor(np.minimum(1000.0 * far, 65534.0)).astype(np.uint16),
        )

    def inside(self, depth: NDArray[Any]) -> NDArray[np.intp]:
        """Pixels whose depth (uint16 [mm] or float32 [m]) lies in the box, ascending."""
        near, far = self._millimetres if depth.dtype == np.uint16 else self._metres
        values = depth.reshape(-1)
        keep = (values >= near) & (values <= far)
        return np.flatnonzero(keep)
