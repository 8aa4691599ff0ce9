"""Errors of a time-of-flight camera: noise that grows with distance, flying pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class DepthNoise:
    """Disturbances of a depth image.

    Attributes:
        sigma: Standard deviation at distance 0 [m].
        sigma_per_m2: What it gains with the square of the distance [1/m].
        flying_fraction: Share of the pixels at depth edges that fly between the two surfaces.
        edge_step: Depth difference to a neighbour that makes an edge [m].
    """

    sigma: float = 0.0006
    sigma_per_m2: float = 0.0008
    flying_fraction: float = 0.0
    edge_step: float = 0.03


def disturb(
    depth: NDArray[np.float32], noise: DepthNoise, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return a disturbed copy of (H, W) depths [m]; infinite ones stay infinite."""
    flown = _fly(depth, noise, rng) if noise.flying_fraction > 0 else depth
    result = flown.copy()
    hit = np.isfinite(flown)
    seen = flown[hit]
    jitter = rng.standard_normal(len(seen), dtype=np.float32)
    spread = np.float32(noise.sigma) + np.float32(noise.sigma_per_m2) * np.square(seen)
    result[hit] = seen + jitter * spread
    return result


def _fly(
    depth: NDArray[np.float32], noise: DepthNoise, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Move some pixels in front of a depth edge to somewhere between both surfaces."""
    behind = depth.copy()
    for axis in (0, 1):
        for shift in (1, -1):
            neighbour = np.roll(depth, shift, axis=axis)
            edge = np.isfinite(neighbour) & (neighbour > depth + noise.edge_step)
            behind[edge] = np.maximum(behind[edge], neighbour[edge])
    rows, columns = np.nonzero(behind > depth)
    chosen = rng.random(len(rows)) < noise.flying_fraction
    at = rows[chosen], columns[chosen]
    part = rng.random(len(at[0]), dtype=np.float32)
    result = depth.copy()
    result[at] = depth[at] + part * (behind[at] - depth[at])
    return result
