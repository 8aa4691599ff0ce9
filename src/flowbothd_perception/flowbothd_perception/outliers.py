"""Flying pixels and stragglers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from flowbothd_common.types import Cloud
from flowbothd_perception.params import OutlierParams


def inliers(points: Cloud, params: OutlierParams) -> NDArray[np.bool_]:
    """(N,) whether each point has neighbours as near as most points, and enough company.

    Two tests: the mean distance to the nearest neighbours against that of all points (statistical
    removal), then the size of the cluster that the point belongs to. Clouds smaller than the
    number of neighbours are kept whole.
    """
    count = len(points)
    keep = np.ones(count, dtype=bool)
    if not params.neighbours or count <= params.neighbours + 1:
        return keep
    distances, indices = cKDTree(points).query(points, k=params.neighbours + 1)
    mean = distances[:, 1:].mean(axis=1)
    keep = mean <= mean.mean() + params.deviations * mean.std()
    if params.cluster > 0:
        keep &= _in_large_cluster(distances, indices, params)
    return np.asarray(keep)


def _in_large_cluster(
    distances: NDArray[np.float64], indices: NDArray[np.intp], params: OutlierParams
) -> NDArray[np.bool_]:
    count = len(indices)
    rows = np.repeat(np.arange(count), indices.shape[1] - 1)
    columns, near = indices[:, 1:].ravel(), distances[:, 1:].ravel() < params.cluster
    graph = coo_matrix((near[near], (rows[near], columns[near])), shape=(count, count))
    labels = connected_components(graph, directed=False)[1]
    return np.asarray(np.bincount(labels)[labels] >= params.cluster_share * count)
