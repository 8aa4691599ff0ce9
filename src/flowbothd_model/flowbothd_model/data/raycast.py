"""One ray per pixel against a triangle soup, in plain torch: exact, batched, on CPU or GPU.

A ray through a pixel meets a triangle exactly when the pixel lies in the triangle's projection, so
the rays that meet a triangle are found row by row: the columns between its edges. The cost follows
the covered area, not rays times triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_NEAR = 0.01
_CHUNK = 4_000_000


@dataclass(frozen=True)
class PixelGrid:
    """A pinhole image: a pixel (column u, row v) looks along ((u + 0.5 - cx) / fx, ..., 1).

    Attributes:
        width: Columns.
        height: Rows.
        fx: Focal length [pixel].
        fy: Focal length [pixel].
        cx: Principal point [pixel].
        cy: Principal point [pixel].
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


def cast_rays(vertices: Tensor, faces: Tensor, grid: PixelGrid) -> tuple[Tensor, Tensor]:
    """First hit of every pixel's ray.

    Args:
        vertices: (V, 3) float32 in the camera frame, z forwards [m].
        faces: (F, 3) int64. Faces that reach nearer than 1 cm to the camera plane are dropped.
        grid: The image.

    Returns:
        (H, W) float32 depth along z [m], infinite where nothing is hit, and (H, W) int64 face, -1.
    """
    inverse_z = 1.0 / vertices[:, 2].clamp(min=_NEAR)
    u = vertices[:, 0] * inverse_z * grid.fx + (grid.cx - 0.5)
    v = vertices[:, 1] * inverse_z * grid.fy + (grid.cy - 0.5)
    in_front = torch.nonzero((vertices[:, 2][faces] > _NEAR).all(1)).flatten()
    chosen = faces[in_front]
    first, last = v[chosen].amin(1).ceil().clamp(min=0), v[chosen].amax(1).floor()
    rows = (last.clamp(max=grid.height - 1) - first + 1).clamp(min=0).long()
    local, row = _expand(first.long(), rows)
    edges = _edges(u[chosen], v[chosen])
    start, length = _spans(edges, local, row, grid.width)
    weight = inverse_z[chosen]  # 1/z is affine in the pixel: blend the edge functions by it
    slope = [(part * weight).sum(1) for part in edges]
    best = torch.full((grid.height * grid.width,), -1, dtype=torch.int64, device=vertices.device)
    for part in _chunks(length):
        span, column = _expand(start[part], length[part])
        owner, line = local[part][span], row[part][span]
        value = slope[0][owner] + slope[1][owner] * column + slope[2][owner] * line
        # Positive floats sort as integers, so that one maximum keeps the nearest hit and its face.
        key = (value.clamp(min=0.0).view(torch.int32).long() << 32) | in_front[owner]
        best.scatter_reduce_(0, line * grid.width + column, key, "amax")
    face = torch.where(best >= 0, best & 0xFFFFFFFF, best)
    inverse = (best.clamp(min=0) >> 32).to(torch.int32).view(torch.float32)
    depth = torch.where(best >= 0, 1.0 / inverse, torch.inf)
    return depth.view(grid.height, grid.width), face.view(grid.height, grid.width)


def _expand(first: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """Owner and value of every element of the ranges first .. first + counts - 1."""
    owner = torch.arange(len(counts), device=counts.device).repeat_interleave(counts)
    start = first - (counts.cumsum(0) - counts)
    return owner, torch.arange(len(owner), device=counts.device) + start[owner]


def _edges(u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Barycentric coordinates as affine functions of the pixel, each (F, 3 corners).

    Corner k of a triangle has weight a + b * column + c * row. NaN for triangles seen edge-on.
    """
    u1, u2, v1, v2 = u.roll(-1, 1), u.roll(-2, 1), v.roll(-1, 1), v.roll(-2, 1)
    a, b, c = u1 * v2 - u2 * v1, v1 - v2, u2 - u1
    area = a.sum(1, keepdim=True)
    scale = torch.where(area.abs() > 1e-9, 1.0 / area, torch.nan)
    return a * scale, b * scale, c * scale


def _spans(
    edges: tuple[Tensor, Tensor, Tensor], local: Tensor, row: Tensor, width: int
) -> tuple[Tensor, Tensor]:
    """First column and number of columns that each (triangle, row) covers."""
    low = torch.zeros_like(row, dtype=torch.float32)
    high = torch.full_like(low, width - 1)
    for corner in range(3):
        a, b, c = (part[:, corner][local] for part in edges)
        level = a + c * row
        crossing = -level / b
        low = torch.where(b > 0, torch.maximum(low, crossing), low)
        high = torch.where(b < 0, torch.minimum(high, crossing), high)
        outside = ((b == 0) & (level < 0)) | b.isnan()
        high = torch.where(outside, -1.0, high)
    start = low.ceil().clamp(max=float(width))
    return start.long(), (high.floor() - start + 1).clamp(min=0).long()


def _chunks(counts: Tensor) -> list[Tensor]:
    """Indices of the spans with pixels, in groups of bounded work."""
    used = torch.nonzero(counts).flatten()
    group = torch.div(counts[used].cumsum(0), _CHUNK, rounding_mode="floor")
    sizes = torch.unique_consecutive(group, return_counts=True)[1].tolist() if len(used) else []
    return list(torch.split(used, sizes)) if sizes else []
