"""Valid points of the clouds that camera drivers publish."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.types import Cloud


def valid_points(values: NDArray[np.float32], max_depth: float = np.inf) -> Cloud:
    """(N, 3) points in the optical frame that were measured and are nearer than `max_depth`.

    Args:
        values: (..., 3), organised or not. Invalid points are NaN, infinite, or (0, 0, 0),
            depending on the driver; all have no positive finite z.
        max_depth: [m].

    Raises:
        InvalidCloudError: the last axis is not 3.
    """
    if values.ndim < 2 or values.shape[-1] != 3:
        raise InvalidCloudError("cloud has the wrong shape", got=values.shape, allowed="(..., 3)")
    points = np.asarray(values, dtype=np.float32).reshape(-1, 3)
    with np.errstate(invalid="ignore"):
        keep = (points[:, 2] > 0) & (points[:, 2] < max_depth)
        keep &= np.isfinite(points[:, 0]) & np.isfinite(points[:, 1])
    return np.ascontiguousarray(points[keep])
