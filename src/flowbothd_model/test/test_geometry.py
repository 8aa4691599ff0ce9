"""Farthest points, balls and interpolation."""

import pytest
import torch

from flowbothd_model.network.geometry import (
    ball,
    farthest_points,
    gather,
    interpolate,
    interpolation,
    nearest,
    squared_distances,
)


def cloud(batch: int = 2, count: int = 300, seed: int = 0) -> torch.Tensor:
    return torch.rand(batch, count, 3, generator=torch.Generator().manual_seed(seed))


def test_farthest_points_are_distinct_and_cover_better_than_chance():
    points = cloud()
    index = farthest_points(points, 40)
    for row in index:
        assert len(set(row.tolist())) == 40

    def cover(chosen: torch.Tensor) -> float:
        return float(squared_distances(points, gather(points, chosen)).amin(-1).amax())

    assert cover(index) < 0.7 * cover(torch.arange(40).expand(2, -1))


def test_farthest_points_do_not_depend_on_the_order():
    points = cloud()
    order = torch.randperm(300, generator=torch.Generator().manual_seed(1))
    same = gather(points[:, order], farthest_points(points[:, order], 30))
    assert torch.allclose(gather(points, farthest_points(points, 30)), same)


def test_more_points_than_there_are_is_an_error():
    with pytest.raises(ValueError, match="cannot choose 301 of 300"):
        farthest_points(cloud(), 301)


def test_a_ball_keeps_the_first_points_by_index():
    points = cloud(1)
    index, valid = ball(points[:, :5], points, 0.4, 8)
    inside = torch.cdist(points[:, :5], points) < 0.4
    for k in range(5):
        expected = torch.nonzero(inside[0, k]).flatten()[:8]
        assert index[0, k][valid[0, k]].tolist() == expected.tolist()
    lonely, mask = ball(points[:, :1], points, 1e-3, 8)
    assert mask[0, 0].tolist() == [True] + [False] * 7
    assert (lonely == 0).all()


def test_nearest_agrees_with_sorting():
    points, queries = cloud(), cloud(count=20, seed=3)
    distances, index = nearest(queries, points, 6)
    full = torch.cdist(queries, points).square()
    assert torch.allclose(distances, full.sort(-1)[0][..., :6], atol=1e-5)
    assert torch.allclose(full.gather(-1, index), distances, atol=1e-5)


def test_interpolation_returns_the_values_at_the_points_themselves_and_any_constant():
    points = cloud()
    values = torch.randn(2, 300, 4, generator=torch.Generator().manual_seed(2))
    weights, index = interpolation(points, points, 3)
    assert torch.allclose(interpolate(values, weights, index), values, atol=1e-2)
    weights, index = interpolation(cloud(count=50, seed=5), points, 3)
    assert torch.allclose(interpolate(torch.ones(2, 300, 1), weights, index), torch.ones(2, 50, 1))
