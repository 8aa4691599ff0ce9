"""Where the depth camera stands, and where pictures are taken from: beside the held face."""

from __future__ import annotations

import numpy as np

from flowbothd_common.types import Array
from flowbothd_evaluation.openings.part import TruePart

_ASIDE_DEG = (35.0, 50.0, 65.0)
_DISTANCE, _HEIGHT = 1.0, 0.7
_BACK, _HIGH = 1.45, 0.95


def camera_view(part: TruePart) -> tuple[Array, Array]:
    """Eye and target (3,) in base: sees the held face at an angle, away from the arm."""
    contact = part.contact(np.zeros(2))
    return contact + _DISTANCE * _aside(part, contact) + (0, 0, _HEIGHT - contact[2]), contact


def picture_view(part: TruePart) -> tuple[Array, Array]:
    """Eye and target (3,) in base: sees arm and held face."""
    contact = part.contact(np.zeros(2))
    middle = 0.6 * contact + (0, 0, 0.25 - 0.4 * contact[2])
    return middle + _BACK * _aside(part, contact) + (0, 0, _HIGH - middle[2]), middle


def _aside(part: TruePart, contact: Array) -> Array:
    """(3,) level unit direction from which the face is seen, the farthest from the arm's base."""
    face = part.outward
    ahead = (
        np.arctan2(face[1], face[0]) if np.hypot(*face[:2]) > 0.5 else np.arctan2(*contact[1::-1])
    )
    angles = ahead + np.radians([sign * turn for turn in _ASIDE_DEG for sign in (1, -1)])
    ways = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=1)
    return np.asarray(ways[np.argmax(np.linalg.norm(contact + ways, axis=1))])
