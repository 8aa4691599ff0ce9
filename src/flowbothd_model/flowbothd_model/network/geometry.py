"""Farthest points, neighbours and interpolation weights: computed once per cloud."""

from __future__ import annotations

import torch
from torch import Tensor


def gather(values: Tensor, index: Tensor) -> Tensor:
    """Rows of `values` (B, N, C) at `index` (B, ...) int64: (B, ..., C)."""
    batch, _, channels = values.shape
    flat = index.reshape(batch, -1, 1).expand(-1, -1, channels)
    return values.gather(1, flat).view(*index.shape, channels)


def squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """(B, N, M) squared distances between `a` (B, N, 3) and `b` (B, M, 3), never negative.

    In full precision also under mixed precision: halved, they would name the wrong neighbours.
    """
    with torch.autocast(a.device.type, enabled=False):
        norms = (a * a).sum(-1).unsqueeze(2) + (b * b).sum(-1).unsqueeze(1)
        return torch.baddbmm(norms, a, b.transpose(1, 2), alpha=-2.0).clamp_(min=0.0)


@torch.no_grad()
def farthest_points(points: Tensor, count: int) -> Tensor:
    """(B, count) int64: indices that cover `points` (B, N, 3) evenly.

    Starts at the point farthest from the mean, so that the choice does not depend on the order of
    the points (the published code starts at random, also when it is evaluated).

    Raises:
        ValueError: fewer than `count` points.
    """
    batch, total, _ = points.shape
    if count > total:
        raise ValueError(f"cannot choose {count} of {total} points")
    x, y, z = (points[..., k].contiguous() for k in range(3))
    mean = points.mean(1, keepdim=True)
    chosen = torch.empty(batch, count, dtype=torch.int64, device=points.device)
    latest = ((points - mean) ** 2).sum(-1).argmax(1, keepdim=True)
    distance = torch.full((batch, total), torch.inf, device=points.device)
    for k in range(count):
        chosen[:, k : k + 1] = latest
        step = (x - x.gather(1, latest)).square_()
        step.addcmul_(dy := y - y.gather(1, latest), dy)
        step.addcmul_(dz := z - z.gather(1, latest), dz)
        torch.minimum(distance, step, out=distance)
        latest = distance.argmax(1, keepdim=True)
    return chosen


@torch.no_grad()
def nearest(queries: Tensor, points: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The `count` nearest of `points` (B, N, 3) to each of `queries` (B, M, 3), nearest first.

    Returns:
        (B, M, count) squared distances and (B, M, count) int64 indices.
    """
    distances, index = squared_distances(queries, points).topk(count, dim=-1, largest=False)
    return distances, index


@torch.no_grad()
def ball(queries: Tensor, points: Tensor, radius: float, cap: int) -> tuple[Tensor, Tensor]:
    """The first `cap` points within `radius` of each query, in index order, as CUDA kernels do.

    Returns:
        (B, M, cap) int64 indices and (B, M, cap) bool, False where an entry is only padding.
    """
    total = points.shape[1]
    inside = squared_distances(queries, points) < radius * radius
    index = torch.arange(total, dtype=torch.int32, device=points.device)
    order = torch.where(inside, index, total).topk(
        min(cap, total), dim=-1, largest=False, sorted=True
    )[0]
    valid = order < total
    return torch.where(valid, order, order[..., :1].clamp(max=total - 1)).long(), valid


@torch.no_grad()
def interpolation(queries: Tensor, points: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Weights by inverse squared distance of the `count` nearest points.

    Returns:
        (B, M, count) weights that sum to one, and (B, M, count) int64 indices.
    """
    distances, index = nearest(queries, points, min(count, points.shape[1]))
    weights = 1.0 / distances.clamp(min=1e-16)
    return weights / weights.sum(-1, keepdim=True), index


def interpolate(values: Tensor, weights: Tensor, index: Tensor) -> Tensor:
    """(B, M, C): `values` (B, N, C) blended by `weights` at `index`, both (B, M, k)."""
    return torch.einsum("bmkc,bmk->bmc", gather(values, index), weights)
