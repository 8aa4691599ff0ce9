"""Rigid transforms as (4, 4) float64 matrices; quaternions are xyzw, vectors are columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from flowbothd_common.types import Array


def unit(vector: ArrayLike) -> Array:
    """Return `vector` scaled to length one.

    Raises:
        ValueError: zero length or not finite.
    """
    array = np.asarray(vector, dtype=float)
    length = float(np.linalg.norm(array))
    if not np.isfinite(length) or length < 1e-12:
        raise ValueError(f"cannot normalise {array.tolist()}: its length is {length}")
    return array / length


def transform(rotation: ArrayLike | None = None, translation: ArrayLike | None = None) -> Array:
    """(4, 4) from a (3, 3) rotation and a (3,) translation, each the identity if omitted."""
    matrix = np.eye(4)
    if rotation is not None:
        matrix[:3, :3] = rotation
    if translation is not None:
        matrix[:3, 3] = translation
    return matrix


def inverse(matrix: Array) -> Array:
    """Inverse of a rigid (4, 4) transform."""
    result = np.eye(4)
    result[:3, :3] = matrix[:3, :3].T
    result[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return result


def apply(matrix: Array, points: Array) -> Array:
    """Map (N, 3) or (3,) points by a (4, 4) transform; keeps the points' dtype if floating."""
    rotation = matrix[:3, :3].astype(points.dtype)
    return np.asarray(points @ rotation.T + matrix[:3, 3].astype(points.dtype))


def rotation_from_quaternion(xyzw: ArrayLike) -> Array:
    """(3, 3) from an xyzw quaternion of any non-zero length.

    Raises:
        ValueError: zero length or not finite.
    """
    x, y, z, w = unit(xyzw)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: Array) -> Array:
    """(4,) unit quaternion xyzw with w >= 0 of a (3, 3) rotation."""
    r = np.asarray(rotation, dtype=float)
    # The largest of the four squared components is computed first: no cancellation near half turns.
    squares = np.array(
        [
            1 + r[0, 0] - r[1, 1] - r[2, 2],
            1 - r[0, 0] + r[1, 1] - r[2, 2],
            1 - r[0, 0] - r[1, 1] + r[2, 2],
            1 + r[0, 0] + r[1, 1] + r[2, 2],
        ]
    )
    k = int(np.argmax(squares))
    if k == 0:
        q = [squares[0], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]]
    elif k == 1:
        q = [r[1, 0] + r[0, 1], squares[1], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]]
    elif k == 2:
        q = [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], squares[2], r[1, 0] - r[0, 1]]
    else:
        q = [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], squares[3]]
    quaternion = unit(q)
    return -quaternion if quaternion[3] < 0 else quaternion


def rotation_about(axis: ArrayLike, angle: float) -> Array:
    """(3, 3) rotation by `angle` [rad] about `axis` (right-hand rule), by Rodrigues' formula."""
    x, y, z = unit(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k))


def rotation_from_rpy(rpy: ArrayLike) -> Array:
    """(3, 3) from fixed-axis roll, pitch, yaw [rad], as URDF means them."""
    roll, pitch, yaw = np.asarray(rpy, dtype=float)
    return np.asarray(
        rotation_about((0, 0, 1), yaw)
        @ rotation_about((0, 1, 0), pitch)
        @ rotation_about((1, 0, 0), roll)
    )


def rotation_between(start: ArrayLike, end: ArrayLike) -> Array:
    """(3, 3) the smallest rotation that turns direction `start` into direction `end`.

    For opposite directions the axis is any normal to them.
    """
    a, b = unit(start), unit(end)
    axis = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(axis)), float(a @ b)
    if sine < 1e-9:
        if cosine > 0:
            return np.eye(3)
        axis = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
    return rotation_about(axis, float(np.arctan2(sine, cosine)))


def angle_between(a: ArrayLike, b: ArrayLike) -> float:
    """Angle between two directions [rad], 0..pi; accurate near both ends."""
    u, v = unit(a), unit(b)
    return float(2 * np.arctan2(np.linalg.norm(u - v), np.linalg.norm(u + v)))


def rotation_angle(rotation: Array) -> float:
    """Angle of a (3, 3) rotation [rad], 0..pi."""
    sine = 0.5 * np.linalg.norm(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    return float(np.arctan2(sine, 0.5 * (np.trace(rotation) - 1)))


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0, 0, 1)) -> Array:
    """T_base_optical of a camera at `eye` looking at `target`.

    The optical frame has z forward, x right, y down (REP-103).

    Raises:
        ValueError: eye and target coincide, or the view is parallel to `up`.
    """
    forward = unit(np.asarray(target, dtype=float) - np.asarray(eye, dtype=float))
    right = unit(np.cross(forward, unit(up)))
    return transform(np.column_stack([right, np.cross(forward, right), forward]), eye)
