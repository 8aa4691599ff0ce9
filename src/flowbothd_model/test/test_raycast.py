"""The ray caster against geometry that is known, and against testing every pair."""

import numpy as np
import torch

from flowbothd_model.data.raycast import PixelGrid, cast_rays

GRID = PixelGrid(40, 30, 35.0, 35.0, 20.3, 14.8)


def rays(grid: PixelGrid) -> torch.Tensor:
    row, column = torch.meshgrid(torch.arange(grid.height), torch.arange(grid.width), indexing="ij")
    x = (column + 0.5 - grid.cx) / grid.fx
    y = (row + 0.5 - grid.cy) / grid.fy
    return torch.stack((x, y, torch.ones_like(x)), dim=-1).double()


def test_every_pair_tested_one_by_one_gives_the_same_image():
    generator = torch.Generator().manual_seed(0)
    vertices = torch.randn(60, 3, generator=generator) * 0.7 + torch.tensor([0.0, 0.0, 3.0])
    faces = torch.arange(60).view(20, 3)
    depth, face = cast_rays(vertices, faces, GRID)
    direction = rays(GRID)
    expected = torch.full(direction.shape[:2], torch.inf, dtype=torch.float64)
    for a, b, c in vertices.double()[faces]:
        matrix = torch.stack(torch.broadcast_tensors(direction, a - b, a - c), dim=-1)
        t, beta, gamma = torch.linalg.solve(matrix, a.expand(direction.shape)).unbind(-1)
        hit = (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1) & (t > 0)
        expected = torch.where(hit & (t < expected), t, expected)
    agree = torch.isfinite(depth) == torch.isfinite(expected)
    assert agree.float().mean() > 0.998  # pixels on an edge may go either way
    both = torch.isfinite(depth) & torch.isfinite(expected)
    assert both.sum() > 200
    close = (depth.double() - expected)[both].abs() < 1e-3
    assert close.float().mean() > 0.998
    assert ((face >= 0) == torch.isfinite(depth)).all()


def test_the_nearer_of_two_planes_is_seen_and_named():
    square = torch.tensor([[-9.0, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]])
    vertices = torch.cat((square + torch.tensor([0, 0, 2.0]), square + torch.tensor([0, 0, 1.5])))
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    depth, face = cast_rays(vertices, faces, GRID)
    assert torch.allclose(depth, torch.full_like(depth, 1.5), atol=1e-4)
    assert (face >= 2).all()


def test_what_is_behind_the_camera_or_beside_the_image_is_not_seen():
    triangle = torch.tensor(
        [[0.0, 0, -1], [1, 0, -1], [0, 1, -1], [50, 0, 1], [51, 0, 1], [50, 1, 1]]
    )
    depth, face = cast_rays(triangle, torch.tensor([[0, 1, 2], [3, 4, 5]]), GRID)
    assert torch.isinf(depth).all()
    assert (face == -1).all()


def test_a_slanted_plane_has_the_depth_of_its_equation():
    corners = torch.tensor([[-4.0, -4, 2], [4, -4, 4], [4, 4, 4], [-4, 4, 2]])
    depth, _ = cast_rays(corners, torch.tensor([[0, 1, 2], [0, 2, 3]]), GRID)
    direction = rays(GRID)
    expected = 3.0 / (1 - 0.25 * direction[..., 0])  # z = 3 + x / 4
    seen = torch.isfinite(depth)
    assert seen.float().mean() > 0.9
    np.testing.assert_allclose(depth[seen], expected[seen], rtol=2e-4)
