"""Rays through the pixels of a depth camera, lens distortion undone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import InvalidCloudError

_ROUNDS = 20
"""Iterations of inverting the lens distortion: enough for wide-angle lenses."""
_LARGEST = 8192
"""Largest side of an image [pixels]: more is a damaged message."""


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a depth camera, as in camera_info.

    Attributes:
        width: [pixels].
        height: [pixels].
        matrix: K row by row: fx, 0, cx, 0, fy, cy, 0, 0, 1 [pixels].
        distortion: k1 k2 p1 p2 k3 k4 k5 k6, or its first 0, 4 or 5; missing ones are 0.

    Raises:
        InvalidCloudError: no size, a focal length that is not positive, numbers that are not
            finite, or another number of coefficients.
    """

    width: int
    height: int
    matrix: tuple[float, ...]
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Refuse an uncalibrated camera."""
        if not (0 < self.width <= _LARGEST and 0 < self.height <= _LARGEST):
            raise InvalidCloudError(
                "camera_info carries no image size",
                got=f"{self.width} x {self.height}",
                allowed=f"1 to {_LARGEST} pixels each way",
            )
        finite = bool(np.isfinite([*self.matrix, *self.distortion]).all())
        if len(self.matrix) != 9 or not finite or self.matrix[0] <= 0 or self.matrix[4] <= 0:
            raise InvalidCloudError(
                "camera_info carries no calibration",
                got=f"K = {list(self.matrix)}",
                allowed="finite numbers, focal lengths > 0",
                hint="check the camera driver; intrinsics are never guessed",
            )
        if len(self.distortion) not in (0, 4, 5, 8):
            # Orbbec's driver calls its 8 coefficients plumb_bob: the number decides, not the name.
            raise InvalidCloudError(
                "distortion model is not supported",
                got=f"{len(self.distortion)} coefficients",
                allowed="0, 4, 5 (Brown) or 8 (rational)",
            )


def ray_table(lens: Lens) -> NDArray[np.float32]:
    """(H, W, 2) x/z and y/z of the ray through each pixel centre; NaN where there is none.

    The depth image of the usual cameras is not rectified: with K alone, points off the centre
    come out wrong by centimetres. The distortion is inverted by fixed-point iteration, once per
    camera; pixels where that does not converge, in the outermost corners, are left out.
    """
    fx, _, cx, _, fy, cy = lens.matrix[:6]
    u, v = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
    seen = np.stack([(u - cx) / fx, (v - cy) / fy], axis=-1)
    if not any(lens.distortion):
        return seen.astype(np.float32)
    rays = seen.copy()
    for _ in range(_ROUNDS):
        factor, shift = _distortion(rays, lens.distortion)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            rays = (seen - shift) / factor[..., None]
    error = np.linalg.norm(distort(rays, lens.distortion) - seen, axis=-1)
    rays[~(error * fx < 0.1)] = np.nan
    return rays.astype(np.float32)


def distort(rays: NDArray[np.float64], coefficients: Sequence[float]) -> NDArray[np.float64]:
    """(..., 2) where the lens puts ideal rays x/z, y/z, in the same units."""
    factor, shift = _distortion(rays, coefficients)
    return np.asarray(rays * factor[..., None] + shift)


def _distortion(
    rays: NDArray[np.float64], coefficients: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, *[0.0] * (8 - len(coefficients)))
    x, y = rays[..., 0], rays[..., 1]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        r2 = x * x + y * y
        factor = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        shift = np.stack(
            [2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y],
            axis=-1,
        )
    return factor, shift
