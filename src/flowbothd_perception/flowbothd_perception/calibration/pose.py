"""Small changes of rigid transforms, and what a calibration came to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flowbothd_common.transforms import (
    inverse,
    quaternion_from_rotation,
    rotation_about,
    rotation_angle,
    transform,
)
from flowbothd_common.types import Array


@dataclass(frozen=True)
class Calibration:
    """The camera's pose and how well it explains what was seen.

    Attributes:
        T_base_camera: (4, 4) pose of the optical frame.
        residual: Root mean square of what is left unexplained [m].
        worst: The same, of the worst arm pose [m].
        spread: Largest shift of the camera if any one arm pose is left out [m].
        spread_angle: The same for its orientation [rad].
        poses: Arm poses used.
        points: Points used.
    """

    T_base_camera: Array
    residual: float
    worst: float
    spread: float
    spread_angle: float
    poses: int
    points: int

    @property
    def parameters(self) -> dict[str, list[float]]:
        """The pose as parameters of perception_node."""
        return {
            "camera.position": [round(float(v), 6) for v in self.T_base_camera[:3, 3]],
            "camera.quaternion": [
                round(float(v), 8) for v in quaternion_from_rotation(self.T_base_camera[:3, :3])
            ],
        }


def twisted(change: Array, pivot: Array) -> Array:
    """(4, 4) a turn by the rotation vector change[3:] about `pivot`, then a shift by change[:3]."""
    angle = float(np.linalg.norm(change[3:]))
    rotation = rotation_about(change[3:], angle) if angle > 1e-12 else np.eye(3)
    return transform(rotation, pivot + change[:3] - rotation @ pivot)


def difference(a: Array, b: Array) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses."""
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3])), rotation_angle((inverse(a) @ b)[:3, :3])
