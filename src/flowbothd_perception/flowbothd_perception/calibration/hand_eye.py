"""Calibration from a board on the tool; the poses of camera and board are both unknown."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.transforms import apply, inverse, transform
from flowbothd_common.types import Array
from flowbothd_perception.calibration.pose import Calibration, difference, twisted

_FEWEST = 3
"""Arm poses at least: two leave one rotation open."""
_SMALLEST_TURN = 0.05
"""Of the tool about a second axis, in the sense of a singular value; less says nothing of depth."""


def rigid_between(start: Array, end: Array) -> Array:
    """(4, 4) the rigid transform that brings (N, 3) points `start` closest to `end` (Kabsch)."""
    a, b = start.mean(axis=0), end.mean(axis=0)
    u, _, vt = np.linalg.svd((end - b).T @ (start - a))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return transform(rotation, b - rotation @ a)


def solve_hand_eye(
    tips: Sequence[Array], boards: Sequence[Array], corners: Array
) -> tuple[Calibration, Array]:
    """Camera pose and the board's pose on the tool, from several poses of the arm.

    A closed form over all pairs of poses (rotation vectors of tool and board must agree, then
    translations are linear) starts a least-squares fit of all corners.

    Args:
        tips: (4, 4) T_base_tip of every arm pose.
        boards: (C, 3) corners of the board in the optical frame, for every arm pose [m].
        corners: (C, 3) the same corners on the board [m].

    Returns:
        The calibration; its residual is that of the corners. And T_tip_board.

    Raises:
        InvalidCloudError: fewer than 3 poses, or the tool has turned about one axis only.
    """
    if len(tips) < _FEWEST or len(tips) != len(boards):
        raise InvalidCloudError(
            "too few arm poses with a board", got=len(boards), allowed=f"at least {_FEWEST}"
        )
    camera, board = _closed_form(tips, [rigid_between(corners, seen) for seen in boards])
    camera, board, misses = _refine(tips, boards, corners, camera, board)
    spread = [(0.0, 0.0)]
    if len(tips) > _FEWEST:
        for out in range(len(tips)):
            rest = [i for i in range(len(tips)) if i != out]
            other, _, _ = _refine(
                [tips[i] for i in rest], [boards[i] for i in rest], corners, camera, board
            )
            spread.append(difference(camera, other))
    each = np.sqrt(np.mean(np.sum(misses**2, axis=-1), axis=-1))
    return Calibration(
        camera,
        float(np.sqrt(np.mean(each**2))),
        float(each.max()),
        max(distance for distance, _ in spread),
        max(angle for _, angle in spread),
        len(tips),
        len(tips) * len(corners),
    ), board


def _closed_form(tips: Sequence[Array], seen: Sequence[Array]) -> tuple[Array, Array]:
    """T_base_camera and T_tip_board with T_base_camera @ seen = tip @ T_tip_board."""
    turns_tip, turns_seen, rows, sides = [], [], [], []
    for i, j in combinations(range(len(tips)), 2):
        tip, board = tips[i] @ inverse(tips[j]), seen[i] @ inverse(seen[j])
        turns_tip.append(Rotation.from_matrix(tip[:3, :3]).as_rotvec())
        turns_seen.append(Rotation.from_matrix(board[:3, :3]).as_rotvec())
        rows.append(tip[:3, :3] - np.eye(3))
        sides.append((tip, board))
    a, b = np.array(turns_seen), np.array(turns_tip)
    second = np.linalg.svd(b / np.sqrt(len(b)), compute_uv=False)[1]
    if second < _SMALLEST_TURN:
        raise InvalidCloudError(
            "the tool has turned about one axis only",
            got=f"{second:.3f} rad about a second one",
            allowed=f"at least {_SMALLEST_TURN} rad",
            hint="tilt the tool in different directions between the captures",
        )
    u, _, vt = np.linalg.svd(b.T @ a)
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    right = np.concatenate([rotation @ board[:3, 3] - tip[:3, 3] for tip, board in sides])
    position = np.linalg.lstsq(np.concatenate(rows), right, rcond=None)[0]
    camera = transform(rotation, position)
    return camera, inverse(tips[0]) @ camera @ seen[0]


def _refine(
    tips: Sequence[Array], boards: Sequence[Array], corners: Array, camera: Array, board: Array
) -> tuple[Array, Array, Array]:
    """Camera, board, and (K, C, 3) what is left between the two ways to each corner."""
    seen = np.stack(boards)
    middle = apply(camera, seen.reshape(-1, 3)).mean(axis=0)
    origin = np.zeros(3)

    def both(change: NDArray[np.float64]) -> tuple[Array, Array]:
        return twisted(change[:6], middle) @ camera, board @ twisted(change[6:], origin)

    def misses(change: NDArray[np.float64]) -> Array:
        now_camera, now_board = both(change)
        on_tool = apply(now_board, corners)
        there = np.stack([apply(tip, on_tool) for tip in tips])
        return apply(now_camera, seen.reshape(-1, 3)).reshape(seen.shape) - there

    solution = least_squares(
        lambda change: misses(change).ravel(),
        np.zeros(12),
        loss="soft_l1",
        f_scale=0.003,
        max_nfev=100,
    )
    return (*both(solution.x), misses(solution.x))
