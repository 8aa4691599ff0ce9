"""Damped, limited inverse kinematics of tool poses from many seeds, and following a path of them.

A tool pose leaves two of seven joints free; the freedom is spent on staying near the middle of
the joint ranges (solving) or on moving little (following).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import (
    Kinematics,
    damped_inverse,
    task_error,
    task_jacobian,
)
from franka_suction_driver.arm.limits import PositionBox

_MAX_STEP = 0.3
"""Largest joint step of an iteration [rad]: the linearisation holds no further."""
_DAMPING = 0.02
"""Damping of steps from far seeds [m or rad per rad]: stronger than along a path, against
singularities."""
FOLLOW_DAMPING = 0.01
"""Damping of steps along a path, where every pose is near the last [m or rad per rad]."""
SOFT_ZONE = 0.25
"""Distance to a limit in which a joint that moves to it gives way to the others [rad]."""


@dataclass(frozen=True)
class Followed:
    """Configurations along a path of tool poses, for a batch of starts.

    Attributes:
        positions: (B, K, J) [rad].
        error: (B, K) distance from the wanted pose, tilt counted as `tilt_length` metres/radian.
        margin: (B, K) distance to the nearest joint limit [rad].
    """

    positions: Array
    error: Array
    margin: Array


def limited_step(box: PositionBox, q: Array, jacobian: Array, miss: Array) -> Array:
    """(..., J) joint step that removes a task error without pushing past a joint limit.

    A joint that moves towards a near limit takes a smoothly vanishing part in the motion and the
    others take over, as far as they can: no joint stops with a jerk.

    Args:
        box: Joint limits.
        q: (..., J) inside the box.
        jacobian: (..., 5, J).
        miss: (..., 5) task error.
    """
    step = (damped_inverse(jacobian, FOLLOW_DAMPING) @ miss[..., None])[..., 0]
    root = joint_weights(box, q, step)
    if root is None:
        return np.asarray(step)
    scaled = damped_inverse(jacobian * root[..., None, :], FOLLOW_DAMPING)
    return np.asarray(root * (scaled @ miss[..., None])[..., 0])


def joint_weights(box: PositionBox, q: Array, step: Array) -> Array | None:
    """(..., J) part in the motion of joints near the limit they move to; None if all have room."""
    room = np.where(step > 0, box.upper - q, q - box.lower)
    # np.clip says the same and takes five times as long on seven numbers.
    near = np.minimum(np.maximum(room / SOFT_ZONE, 0.0), 1.0)
    if near.min() >= 1.0:
        return None
    return np.asarray(np.sqrt(near * near * (3.0 - 2.0 * near)))


def _free_pull(box: PositionBox, q: Array, jacobian: Array, strength: float) -> Array:
    """(..., J) step towards the middle of the joint ranges that leaves the tool where it is."""
    middle, half = (box.lower + box.upper) / 2, (box.upper - box.lower) / 2
    pull = (strength * (middle - q) / half**2)[..., None]
    return np.asarray((pull - damped_inverse(jacobian, _DAMPING) @ (jacobian @ pull))[..., 0])


def solve(
    kinematics: Kinematics,
    box: PositionBox,
    seeds: Array,
    position: Array,
    axis: Array,
    *,
    iterations: int = 40,
    centring: float = 0.05,
    tolerance: float = 1e-4,
) -> Array:
    """(S, J) configurations that take the tool to a pose; seeds that do not get there are dropped.

    Args:
        kinematics: The arm.
        box: Joint limits, never left.
        seeds: (B, J) where to start.
        position: (3,) tip position in base [m].
        axis: (3,) unit direction of the tool's z axis in base.
        iterations: At most this many Newton steps.
        centring: Pull towards the middle of the joint ranges within the free motions.
        tolerance: Accepted error [m, and rad of tilt].
    """
    q = box.clip(np.array(seeds, dtype=float))
    for k in range(iterations):
        state = kinematics.tip(q)
        jacobian = task_jacobian(state)
        inverse = damped_inverse(jacobian, _DAMPING)
        # The error is a column: matmul needs the trailing axis.
        error = task_error(state, position, axis)[..., None]
        step = inverse @ error
        step = step[..., 0]
        if centring and k < iterations // 2:
            step = step + _free_pull(box, q, jacobian, centring)
        length = np.abs(step).max(axis=-1, keepdims=True)
        q = box.clip(q + step * np.minimum(1.0, _MAX_STEP / np.maximum(length, 1e-12)))
    error = task_error(kinematics.tip(q), position, axis)
    good = np.linalg.norm(error, axis=-1) < tolerance
    return np.asarray(q[good])


def follow(
    kinematics: Kinematics,
    box: PositionBox,
    starts: Array,
    positions: Array,
    axes: Array,
    *,
    iterations: int = 4,
    tilt_length: float = 0.1,
    centring: float = 0.0,
) -> Followed:
    """Track a path of tool poses from each start by the smallest joint motion, inside the limits.

    Args:
        kinematics: The arm.
        box: Joint limits, never left; a path that would leave them shows as an error.
        starts: (B, J) configurations near the path's first pose.
        positions: (K, 3) tip positions in base [m].
        axes: (K, 3) unit directions of the tool's z axis in base.
        iterations: Newton steps per pose.
        tilt_length: Metres that one radian of tilt counts in the reported error.
        centring: Pull towards the middle of the joint ranges within the free motions.
    """
    q = np.array(starts, dtype=float)
    count = len(positions)
    path = np.empty((len(q), count, kinematics.dof))
    error = np.empty((len(q), count))
    weights = np.array([1.0, 1.0, 1.0, tilt_length, tilt_length])
    for k in range(count):
        for _ in range(iterations):
            state = kinematics.tip(q)
            miss = task_error(state, positions[k], axes[k])
            jacobian = task_jacobian(state)
            step = limited_step(box, q, jacobian, miss)
            if centring:
                step = step + _free_pull(box, q, jacobian, centring)
            q = box.clip(q + step)
        miss = task_error(kinematics.tip(q), positions[k], axes[k])
        path[:, k] = q
        error[:, k] = np.linalg.norm(miss * weights, axis=-1)
    return Followed(path, error, box.margin(path))
