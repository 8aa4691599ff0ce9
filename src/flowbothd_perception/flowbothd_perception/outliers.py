"""Flying pixels and stragglers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from flowbothd_common.types import Cloud
from flowbothd_perception.params import OutlierParams

_REACH = 2
"""Pixels to each side that are a pixel's neighbours."""

_PAIRS = 4
"""Of the 12 pairs of opposite neighbours, how many must lie on a line through the pixel."""

_STEEPEST = 4.0
"""Steps to opposite neighbours larger than this many tolerances belong to no surface."""


def on_surface(
    depth: NDArray[Any],
    unit: float,
    pixels: NDArray[np.intp],
    pitch: float,
    params: OutlierParams,
) -> NDArray[np.bool_]:
    """(n,) whether each pixel belongs to a surface, judged by its neighbours in the image.

    A flying pixel hangs between the edge of one surface and the next one behind it: few of the 24
    pixels around it are as far away. On a surface seen at a grazing angle few are either, but there
    opposite neighbours are as much nearer as farther. This sees single pixels a centimetre off a
    surface, which distances in space cannot, since it uses every pixel and not only drawn ones.

    Args:
        depth: (H, W), invalid pixels 0 or NaN.
        unit: Of the depths [m].
        pixels: (n,) flat indices of those to judge.
        pitch: Angle between neighbouring pixels [rad].
        params: min_depth_neighbors and tolerance; min_depth_neighbors 0 keeps every pixel.
    """
    height, width = depth.shape
    side = 2 * _REACH + 1
    if params.min_depth_neighbors < 1 or not len(pixels) or height < side or width < side:
        return np.ones(len(pixels), dtype=bool)
    rows, columns = np.divmod(pixels, width)
    # At the border the window is shifted inwards: it always has 25 pixels.
    rows = np.clip(rows, _REACH, height - 1 - _REACH)
    columns = np.clip(columns, _REACH, width - 1 - _REACH)
    centre = rows * width + columns
    steps = np.arange(-_REACH, _REACH + 1)
    # Half of the window; the other half lies opposite.
    half = (steps[:, None] * width + steps).ravel()[: side * side // 2]
    flat = depth.reshape(-1)
    own = flat[pixels].astype(np.float32)
    band = np.maximum(
        own * np.float32(params.steepness * pitch), np.float32(params.tolerance / unit)
    )
    support = np.zeros(len(pixels), dtype=np.int16)
    with np.errstate(invalid="ignore", over="ignore"):
        for offset in (*half, *-half):
            support += np.abs(flat[centre + offset] - own) <= band
        keep = support >= params.min_depth_neighbors
        rest = np.flatnonzero(~keep)
        centre, own, band = centre[rest], own[rest], band[rest]
        pairs = np.zeros(len(rest), dtype=np.int16)
        for offset in half:
            before, after = flat[centre + offset] - own, flat[centre - offset] - own
            pairs += (np.abs(before + after) <= 2 * band) & (np.abs(before) <= _STEEPEST * band)
    keep[rest[pairs >= _PAIRS]] = True
    return np.asarray(keep)


def inliers(points: Cloud, params: OutlierParams) -> NDArray[np.bool_]:
    """(N,) whether each point has neighbours as near as most points, and enough company.

    Two tests: the mean distance to the nearest neighbours against that of all points (statistical
    removal), then the size of the cluster that the point belongs to. Clouds smaller than the
    number of neighbours are kept whole.
    """
    count = len(points)
    keep = np.ones(count, dtype=bool)
    if not params.nb_neighbors or count <= params.nb_neighbors + 1:
        return keep
    distances, indices = cKDTree(points).query(points, k=params.nb_neighbors + 1)
    mean = distances[:, 1:].mean(axis=1)
    keep = mean <= mean.mean() + params.std_ratio * mean.std()
    if params.cluster_tolerance > 0:
        keep &= _in_large_cluster(distances, indices, params)
    return np.asarray(keep)


def beside(points: Cloud, chosen: Cloud, reach: float) -> NDArray[np.bool_]:
    """(N,) whether each point is one to two `reach` from a chosen one, on a grid of that size."""
    if not len(points) or not len(chosen):
        return np.zeros(len(points), dtype=bool)
    low = np.minimum(points.min(axis=0), chosen.min(axis=0)) - reach
    cells = np.floor((points - low) / reach).astype(np.intp)
    occupied = np.floor((chosen - low) / reach).astype(np.intp)
    shape = np.maximum(cells.max(axis=0), occupied.max(axis=0)) + 2
    grid = np.zeros(shape, dtype=bool)
    grid[tuple(occupied.T)] = True
    return np.asarray(binary_dilation(grid, np.ones((3, 3, 3)))[tuple(cells.T)])


def _in_large_cluster(
    distances: NDArray[np.float64], indices: NDArray[np.intp], params: OutlierParams
) -> NDArray[np.bool_]:
    count, each = len(indices), indices.shape[1] - 1
    # A neighbour that is too far off is replaced by the point itself: rows of equal length need no
    # sorting.
    near = np.where(
        distances[:, 1:] < params.cluster_tolerance, indices[:, 1:], np.arange(count)[:, None]
    )
    links = np.ones(near.size, dtype=np.int8), near.ravel(), np.arange(0, near.size + 1, each)
    graph = csr_matrix(links, shape=(count, count))
    labels = connected_components(graph, directed=True, connection="weak")[1]
    return np.asarray(np.bincount(labels)[labels] >= params.cluster_share * count)
