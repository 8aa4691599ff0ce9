"""A part while the arm hides it from the camera: where it is, and what is around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.motion import MotionGoal, MotionResult
from flowbothd_common.transforms import apply, inverse
from flowbothd_common.types import Cloud
from franka_suction_driver.planning.collision import Box
from franka_suction_driver.planning.continuation import (
    PlateExtent,
    moving_part,
    plate_extent,
    swings,
)

_AROUND = 0.02


class HeldPart:
    """Remembers what was seen before the arm came, and follows the part by the tool's path.

    An arm that leaves a door stands before it: neither the leaf, in its present place, nor the
    frame behind the arm are in the cloud.
    """

    def __init__(self) -> None:
        self._extent = PlateExtent()
        self._plate: Box | None = None
        self._closed: Box | None = None
        self._seen: Cloud | None = None

    @property
    def plate(self) -> Box | None:
        """A swinging part where it was last held; None if nothing is known of one."""
        return self._plate

    def approached(self, goal: MotionGoal, seen: Cloud | None) -> None:
        """Begin anew with an approach.

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
        """Follow a flow step: the part is where the tool holds it."""
        tip = result.tool_end
        if goal.direction is None or not swings(goal.joint, tip[:3, 3]):
            return
        side = 1 if float(tip[:3, 2] @ goal.direction) < 0 else -1
        self._plate = moving_part(tip[:3, 3], goal.direction, side, goal.joint, self._extent)
        if self._closed is not None and self._seen is not None:
            self._seen, self._closed = self._seen[_outside(self._closed, self._seen)], None

    def completed(self, seen: Cloud | None) -> Cloud | None:
        """A cloud together with what was seen before the arm came, but for a part that moved.

        A cloud without a point is none, and stays so: there may be no camera.
        """
        if seen is None or self._seen is None:
            return seen
        return np.concatenate([seen, self._seen])


def _outside(box: Box, points: Cloud) -> NDArray[np.bool_]:
    """(N,) whether points lie well outside a box."""
    local = apply(inverse(box.pose), points.astype(float))
    return np.asarray((np.abs(local) > np.array(box.size) / 2 + _AROUND).any(axis=1))
