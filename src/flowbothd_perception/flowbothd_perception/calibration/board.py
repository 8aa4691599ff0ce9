"""Finding a printed chessboard in a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import FlowBotError, ParameterError
from flowbothd_common.types import Array
from flowbothd_perception.depth import Lens


@dataclass(frozen=True)
class Board:
    """A chessboard.

    Attributes:
        columns: Inner corners along a row.
        rows: Inner corners along a column. One number odd, the other even: otherwise the board
            looks the same when it is turned by half, and poses get mixed up.
        square: Side of a square, measured on the print [m].
    """

    columns: int
    rows: int
    square: float

    def __post_init__(self) -> None:
        """Refuse boards that look the same when turned around."""
        if min(self.columns, self.rows) < 3 or (self.columns + self.rows) % 2 == 0:
            raise ParameterError(
                "the board looks the same when turned by half",
                got=f"{self.columns} x {self.rows} inner corners",
                allowed="at least 3 x 3, one number odd and the other even, such as 9 x 6",
            )
        if not 0.002 < self.square < 0.5:
            raise ParameterError(
                "side of the board's squares", got=f"{self.square} m", allowed="0.002 to 0.5 m"
            )

    @property
    def corners(self) -> Array:
        """(columns * rows, 3) inner corners on the board [m], row by row, z = 0."""
        u, v = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        flat = np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], axis=1)
        return np.asarray(self.square * flat)


def find_board(picture: NDArray[np.uint8], lens: Lens, board: Board) -> Array | None:
    """(C, 3) inner corners in the optical frame [m]; None if the board is not in the picture.

    Args:
        picture: (H, W) brightness, such as the infrared image of a depth camera.
        lens: That took it, distortion included.
        board: Whose corners are looked for.

    Raises:
        FlowBotError: OpenCV is not installed.
    """
    try:
        import cv2
    except ImportError as error:
        raise FlowBotError(
            "finding a printed board needs OpenCV",
            hint="pip install opencv-python-headless, or calibrate from the tool instead",
        ) from error
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    found, pixels = cv2.findChessboardCornersSB(picture, (board.columns, board.rows), flags=flags)
    if not found:
        return None
    matrix = np.array(lens.matrix).reshape(3, 3)
    distortion = np.array(lens.distortion or (0.0,) * 5)
    solved, turn, shift = cv2.solvePnP(board.corners, pixels, matrix, distortion)
    if not solved:
        return None
    rotation, _ = cv2.Rodrigues(turn)
    return np.asarray(board.corners @ rotation.T + shift.reshape(3))
