"""Seeded choice of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def sample(available: int, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """(min(available, count),) numbers below `available`, chosen without repetition.

    All of them, in order, if there are no more.
    """
    if available <= count:
        return np.arange(available)
    return rng.choice(available, count, replace=False)
