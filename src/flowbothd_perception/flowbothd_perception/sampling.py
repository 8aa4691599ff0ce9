"""Seeded choice of points."""

from __future__ import annotations

import numpy as np

from flowbothd_common.types import Cloud


def sample(points: Cloud, count: int, rng: np.random.Generator) -> Cloud:
    """(min(N, count), 3) points chosen without repetition; all of them if there are no more."""
    if len(points) <= count:
        return points
    return points[rng.choice(len(points), count, replace=False)]
