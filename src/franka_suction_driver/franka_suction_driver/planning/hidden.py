"""What a seen surface may hide: room behind it that the arm keeps out of."""

from __future__ import annotations

import numpy as np

from flowbothd_common.types import Array, Cloud, as_cloud


def hidden_points(points: Cloud, eye: Array, depth: float, cell: float) -> Cloud:
    """Points behind a seen surface, as far as `depth` along the line of sight.

    A camera sees the front of a door frame, not how deep it is. What lies further behind than
    `depth` is taken to be free, because else nothing could ever be reached from behind.

    Args:
        points: (N, 3) seen points in base [m]; N may be 0.
        eye: (3,) the camera in base [m].
        depth: Thickness to presume [m]; 0 = none.
        cell: Edge of the cells that the result is thinned to, one point each [m].

    Returns:
        (M, 3) float32 in base, in a fixed order; none where depth is 0.
    """
    seen = _thinned(as_cloud(points, min_points=0), cell)
    if depth <= 0:
        return seen[:0]
    away = seen - np.asarray(eye, dtype=np.float32)
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
    layers = np.append(np.arange(cell, depth, cell), depth)[:, None, None].astype(np.float32)
    solid = seen[None] + layers * away[None]
    return _thinned(solid.reshape(-1, 3), cell)


def _thinned(points: Cloud, cell: float) -> Cloud:
    """The first point of every occupied cell."""
    _, first = np.unique(np.floor(points / cell).astype(np.int32), axis=0, return_index=True)
    return np.ascontiguousarray(points[np.sort(first)])
