"""Occluded volume: behind observed surfaces, and where the arm hides the part that it holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.motion import MotionGoal, MotionResult
from flowbothd_common.transforms import apply, inverse
from flowbothd_common.types import Array, Cloud, as_cloud
from franka_suction_driver.planning.collision import Box
from franka_suction_driver.planning.opening_path import (
    PlateExtent,
    moving_part,
    plate_extent,
    swings,
)

_CLEARANCE = 0.02
"""Remembered points this close to the closed part are taken for the part itself [m]: the depth
camera's noise and the outlier filter blur its surface by about that much."""


def hidden_points(points: Cloud, eye: Array, depth: float, cell: float) -> Cloud:
    """Return points behind an observed surface, as far as `depth` along the line of sight.

    A camera sees the front of a door frame, not how deep it is. What lies further behind than
    `depth` is taken to be free, because otherwise nothing could be reached from behind.

    Args:
        points: (N, 3) observed points in base [m]; N may be 0.
        eye: (3,) camera position in base [m].
        depth: Presumed thickness [m]; 0 = none.
        cell: Edge of the cells that the result is thinned to, one point each [m].

    Returns:
        (M, 3) float32 in base, in a fixed order; none where depth is 0.
    """
    seen = _thinned(as_cloud(points, min_points=0), cell)
    if depth <= 0:
        return seen[:0]
    away = seen - np.asarray(eye, dtype=np.float32)
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
    layers = np.append(np.arange(cell, depth, cell), depth)[:, None, None].astype(np.float32)
    solid = seen[None] + layers * away[None]
    return _thinned(solid.reshape(-1, 3), cell)


class OccludedPart:
    """The part while the arm hides it: the cloud from before the approach, and the tool's path.

    An arm that retreats from a door stands in front of it: neither the leaf, in its present place,
    nor the frame behind the arm are in the cloud.
    """

    def __init__(self) -> None:
        self._extent = PlateExtent()
        self._plate: Box | None = None
        self._closed: Box | None = None
        self._seen: Cloud | None = None

    @property
    def plate(self) -> Box | None:
        """A swinging part where it was last held; None if none is known."""
        return self._plate

    def approached(self, goal: MotionGoal, seen: Cloud | None) -> None:
        """Forget the part before and remember the cloud of an approach.

        Args:
            goal: Of the approach.
            seen: (N, 3) cloud in base that it was planned with, or None.
        """
        self._plate, self._extent, self._closed, self._seen = None, PlateExtent(), None, seen
        contact, direction, joint = goal.contact, goal.direction, goal.joint
        if contact is None or direction is None or not swings(joint, contact):
            return
        self._extent = plate_extent(contact, direction, joint, seen)
        self._closed = moving_part(contact, direction, 1, joint, self._extent)

    def stepped(self, goal: MotionGoal, result: MotionResult) -> None:
        """Move the part along with a flow step: it is where the tool holds it."""
        tip = result.tool_end
        if goal.direction is None or not swings(goal.joint, tip[:3, 3]):
            return
        side = 1 if float(tip[:3, 2] @ goal.direction) < 0 else -1
        self._plate = moving_part(tip[:3, 3], goal.direction, side, goal.joint, self._extent)
        if self._closed is not None and self._seen is not None:
            self._seen, self._closed = self._seen[_outside(self._closed, self._seen)], None

    def completed(self, seen: Cloud | None) -> Cloud | None:
        """Return a cloud together with the remembered one, without a part that has moved since.

        None stays None: there may be no camera.
        """
        if seen is None or self._seen is None:
            return seen
        return np.concatenate([seen, self._seen])


def _thinned(points: Cloud, cell: float) -> Cloud:
    """Return the first point of every occupied cell."""
    _, first = np.unique(np.floor(points / cell).astype(np.int32), axis=0, return_index=True)
    return np.ascontiguousarray(points[np.sort(first)])


def _outside(box: Box, points: Cloud) -> NDArray[np.bool_]:
    """Return (N,) True for points farther than `_CLEARANCE` from a box."""
    local = apply(inverse(box.pose), points.astype(float))
    return np.asarray((np.abs(local) > np.array(box.size) / 2 + _CLEARANCE).any(axis=1))
