"""The workspace box."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.types import Cloud
from flowbothd_perception.params import CropParams


def inside_box(points: Cloud, params: CropParams) -> NDArray[np.bool_]:
    """(N,) whether each point (in base) lies in the box; points that are not finite do not."""
    low = np.asarray(params.min_corner, dtype=points.dtype)
    high = np.asarray(params.max_corner, dtype=points.dtype)
    # Column by column: one axis of a box far from the camera rejects most points by itself.
    keep = (points[:, 0] >= low[0]) & (points[:, 0] <= high[0])
    for axis in (1, 2):
        keep &= (points[:, axis] >= low[axis]) & (points[:, axis] <= high[axis])
    return np.asarray(keep)
