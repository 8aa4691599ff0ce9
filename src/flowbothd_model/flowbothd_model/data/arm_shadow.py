"""The shadow of a robot's arm that touches the object: a hole in what the camera sees.

During a run the cloud lacks just the place that the cup holds, and a band from there to the edge
of the picture, wherever the arm comes from.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.transforms import unit
from flowbothd_common.types import Array
from flowbothd_model.data.articulated import Ints

_CUP, _STEM = (0.0, 0.02), (0.06, 0.025)
_PUMP, _ARM = (0.10, 0.055), (0.22, 0.075)
_REACH = 0.9
"""Distance from the contact and radius of what hides: cup, stem, pump, forearm [m]."""

_SPHERES = 20
_MOST = 0.6


def hidden_by_arm(
    seen: Array, link: Ints, metre: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """(M,) whether the arm hides a point; none, if it hid nearly all of the link it touches.

    Args:
        seen: (M, 3) in the optical frame.
        link: (M,) that each point belongs to.
        metre: Length of a metre in the units of `seen`.
        rng: Where the arm touches and from where it comes.
    """
    touched = int(rng.integers(len(seen)))
    contact = seen[touched]
    towards_camera = -unit(contact)
    first = unit(towards_camera + 0.9 * rng.normal(size=3))
    second = unit(first + 0.7 * rng.normal(size=3))
    distances = _REACH * np.linspace(0.0, 1.0, _SPHERES) ** 2  # closer where it is thin
    starts, sizes = np.array((_CUP, _STEM, _PUMP, _ARM)).T
    radii = np.interp(distances, starts, sizes) * metre
    bend = _ARM[0] + 0.1
    way = (
        np.minimum(distances, bend)[:, None] * first
        + np.maximum(distances - bend, 0.0)[:, None] * second
    )
    centres = (contact + metre * way).astype(np.float32)  # (K, 3)
    depth = np.linalg.norm(seen, axis=1).astype(np.float32)
    rays = seen.astype(np.float32) / depth[:, None]
    along = centres @ rays.T  # (K, M)
    off = np.sum(centres**2, axis=1)[:, None] - along**2
    # The part itself may lie a little in front of the contact that was drawn on it.
    nearer = along < depth + 0.02 * metre
    hidden = np.asarray(((off < radii[:, None] ** 2) & (along > 0) & nearer).any(0))
    if hidden[link == link[touched]].mean() > _MOST:
        return np.zeros(len(seen), dtype=bool)
    return hidden
