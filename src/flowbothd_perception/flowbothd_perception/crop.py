"""The workspace box."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.types import Array, Cloud
from flowbothd_perception.params import CropParams


def inside_box(points: Cloud, params: CropParams) -> NDArray[np.bool_]:
    """(N,) whether each point (in base) lies in the box; points that are not finite do not."""
    keep = np.ones(len(points), dtype=bool)
    for axis, (low, high) in enumerate(zip(params.min_corner, params.max_corner, strict=True)):
        keep &= (points[:, axis] >= np.float32(low)) & (points[:, axis] <= np.float32(high))
    return keep


def crop_to_base(points: Cloud, T_base_camera: Array, params: CropParams) -> Cloud:
    """(M, 3) the points inside the box, carried into the base frame.

    Height is computed first and alone: it cuts off the table, which is most of a frame, before
    the rest has to be transformed.
    """
    matrix = T_base_camera.astype(np.float32)
    left = points
    for axis in (2, 0, 1):
        along = left @ matrix[axis, :3] + matrix[axis, 3]
        low, high = np.float32(params.min_corner[axis]), np.float32(params.max_corner[axis])
        left = left[(along >= low) & (along <= high)]
    return np.asarray(left @ matrix[:3, :3].T + matrix[:3, 3], dtype=np.float32)
