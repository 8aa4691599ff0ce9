"""One frame of a depth camera, whichever way the driver sends it, on its pixel grid."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.types import Array, Cloud
from flowbothd_perception.crop import DepthCrop, inside_box, to_base
from flowbothd_perception.params import CropParams

Indices = NDArray[np.intp]
"""Flat pixel numbers, row by row."""

_FINEST_PITCH, _COARSEST_PITCH = 0.002, 0.006
"""Angles between neighbouring points that are tried for the grid of a loose cloud [rad]."""

_AGREEMENT = 0.01
"""Difference of depths within a pixel of such a grid that is no contradiction [m]."""


class Frame(Protocol):
    """Measurements, pixel by pixel."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns; one row for a loose cloud."""

    def measured(self) -> int:
        """Number of pixels with a measurement."""

    def inside(self, T_base_camera: Array, params: CropParams) -> Indices:
        """Pixels whose points lie in the workspace, ascending."""

    def points(self, pixels: Indices) -> Cloud:
        """(n, 3) points of the pixels, in the optical frame."""

    def grid(self, pixels: Indices) -> tuple[NDArray[Any], float, Indices, float]:
        """Depths on an image, for looking at neighbours.

        Returns:
            (H, W) depths; what one unit of them is in metres; where in the image the given pixels
            are; the angle between neighbouring pixels [rad]. A cloud so thin that points have no
            neighbours gives an image of one pixel.
        """


class Optics:
    """Rays of a lens, and the last workspace seen through it.

    Args:
        rays: (H, W, 2) x/z and y/z of every pixel, NaN where there is none (`ray_table`).
    """

    def __init__(self, rays: NDArray[np.float32]) -> None:
        self.rays = rays.reshape(-1, 2)
        self.shape = (rays.shape[0], rays.shape[1])
        middle = rays[rays.shape[0] // 2]
        self.pitch = float(np.nanmedian(np.abs(np.diff(middle[:, 0])))) if len(middle) > 1 else 1.0
        self._crop: tuple[tuple[bytes, CropParams, float], DepthCrop] | None = None

    def crop(self, T_base_camera: Array, params: CropParams, max_depth: float) -> DepthCrop:
        """The workspace as limits of every pixel's depth; computed only when it changes."""
        key = (T_base_camera.tobytes(), params, max_depth)
        if self._crop is None or self._crop[0] != key:
            self._crop = key, DepthCrop(self.rays, T_base_camera, params, max_depth)
        return self._crop[1]


class DepthFrame:
    """A depth image and the lens that took it.

    Args:
        depth: (H, W) uint16 [mm] or float32 [m]. Zero, negative, infinite and NaN values are no
            measurements.
        optics: Of the same size.
        max_depth: Farther measurements do not count [m].

    Raises:
        InvalidCloudError: another type, or sizes that differ.
    """

    def __init__(self, depth: NDArray[Any], optics: Optics, max_depth: float = np.inf) -> None:
        if depth.dtype not in (np.uint16, np.float32):
            raise InvalidCloudError(
                "depth image has the wrong type",
                got=depth.dtype,
                allowed="uint16 [mm] or float32 [m]",
            )
        if depth.shape != optics.shape:
            raise InvalidCloudError(
                "depth image and camera_info differ in size", got=(depth.shape, optics.shape)
            )
        self._depth = np.ascontiguousarray(depth)
        self._unit = 0.001 if depth.dtype == np.uint16 else 1.0
        self._optics, self._max_depth = optics, max_depth

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self._optics.shape

    def measured(self) -> int:
        """Number of pixels with a measurement."""
        if self._depth.dtype == np.uint16:
            return int(np.count_nonzero(self._depth))
        return int(np.count_nonzero((self._depth > 0) & (self._depth < np.float32(np.inf))))

    def inside(self, T_base_camera: Array, params: CropParams) -> Indices:
        """Pixels whose points lie in the workspace, ascending."""
        return self._optics.crop(T_base_camera, params, self._max_depth).inside(self._depth)

    def points(self, pixels: Indices) -> Cloud:
        """(n, 3) points of the pixels, in the optical frame."""
        z = self._depth.reshape(-1)[pixels] * np.float32(self._unit)
        result = np.empty((len(pixels), 3), dtype=np.float32)
        np.multiply(self._optics.rays[pixels], z[:, None], out=result[:, :2])
        result[:, 2] = z
        return result

    def grid(self, pixels: Indices) -> tuple[NDArray[Any], float, Indices, float]:
        """The image itself."""
        return self._depth, self._unit, pixels, self._optics.pitch


class CloudFrame:
    """A cloud, organised or not.

    Args:
        values: (H, W, 3) organised, or (N, 3) or (1, N, 3) loose; float32 [m], optical frame.
            Points that were not measured are NaN, infinite, or (0, 0, 0).
        max_depth: Points farther along z do not count [m].

    Raises:
        InvalidCloudError: another shape.
    """

    def __init__(self, values: NDArray[Any], max_depth: float = np.inf) -> None:
        if values.ndim not in (2, 3) or values.shape[-1] != 3:
            raise InvalidCloudError(
                "cloud has the wrong shape", got=values.shape, allowed="(H, W, 3) or (N, 3)"
            )
        height, width = values.shape[:2] if values.ndim == 3 else (1, values.shape[0])
        # One column is as loose as one row.
        self.shape = (1, height * width) if width == 1 else (height, width)
        # Coordinates apart: arithmetic on every third number takes several times as long.
        self._x, self._y, self._z = (
            np.ascontiguousarray(values[..., axis], dtype=np.float32).reshape(-1)
            for axis in range(3)
        )
        self._max_depth = max_depth

    def measured(self) -> int:
        """Number of measured points."""
        return int(np.count_nonzero((self._z > 0) & (self._z < np.float32(np.inf))))

    def inside(self, T_base_camera: Array, params: CropParams) -> Indices:
        """Points that lie in the workspace, ascending.

        Height is computed first and alone: it cuts off the table, which is most of a frame.
        """
        matrix = T_base_camera.astype(np.float32)
        low, high = np.float32(params.min_corner[2]), np.float32(params.max_corner[2])
        with np.errstate(invalid="ignore", over="ignore"):
            # Not as a matrix product: that takes ten times as long, and longer with NaN.
            height = self._x * matrix[2, 0]
            height += self._y * matrix[2, 1]
            height += self._z * matrix[2, 2]
            height += matrix[2, 3]
            keep = (height >= low) & (height <= high) & (self._z > 0)
            pixels = np.flatnonzero(keep)
            left = self.points(pixels)
            base = to_base(T_base_camera, left)
            # Zero times infinity: such points are invalid, and the box refuses NaN.
            return pixels[inside_box(base, params) & (left[:, 2] <= np.float32(self._max_depth))]

    def points(self, pixels: Indices) -> Cloud:
        """(n, 3) points, in the optical frame."""
        result = np.empty((len(pixels), 3), dtype=np.float32)
        for axis, values in enumerate((self._x, self._y, self._z)):
            result[:, axis] = values[pixels]
        return result

    def grid(self, pixels: Indices) -> tuple[NDArray[Any], float, Indices, float]:
        """The z of an organised cloud; for a loose one, those points seen through a pinhole."""
        if self.shape[0] > 1:
            depth = self._z.reshape(self.shape)
            return depth, 1.0, pixels, _pitch_of(self._x.reshape(self.shape), depth)
        points = self.points(pixels)
        with np.errstate(over="ignore"):
            rays = points[:, :2] / points[:, 2:]
        pitch = _FINEST_PITCH
        while pitch < _COARSEST_PITCH:
            image, where = _seen_through_pinhole(rays, points[:, 2], pitch)
            filled = image > 0
            # Neighbours must mostly be there (a thinned cloud needs coarser pixels), and points
            # that share a pixel must agree (those drawn at random from a steep surface do not).
            beside = np.count_nonzero(filled[:, 1:] & filled[:, :-1])
            agree = np.count_nonzero(np.abs(image.ravel()[where] - points[:, 2]) < _AGREEMENT)
            if beside > 0.7 * np.count_nonzero(filled) and agree > 0.9 * len(pixels):
                return image, 1.0, where, pitch
            pitch *= 1.5
        return np.zeros((1, 1), np.float32), 1.0, np.zeros(len(pixels), np.intp), pitch


def _seen_through_pinhole(
    rays: NDArray[np.float32], z: NDArray[np.float32], pitch: float
) -> tuple[NDArray[np.float32], Indices]:
    if not len(rays):
        return np.zeros((1, 1), dtype=np.float32), np.zeros(0, dtype=np.intp)
    # Nothing useful is seen beyond 80 degrees; limits keep a stray point from filling memory.
    u, v = (np.rint(np.clip(rays[:, axis], -6.0, 6.0) / np.float32(pitch)) for axis in (0, 1))
    left, top = u.min(), v.min()
    width, height = int(u.max() - left) + 1, int(v.max() - top) + 1
    where = (v - top).astype(np.intp) * width + (u - left).astype(np.intp)
    image = np.zeros(height * width, dtype=np.float32)
    image[where] = z
    return image.reshape(height, width), where


def _pitch_of(x: NDArray[np.float32], z: NDArray[np.float32]) -> float:
    """Angle between neighbouring points of an organised cloud, from a few of its rows [rad]."""
    every = max(1, len(x) // 8)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        steps = np.abs(np.diff(x[::every] / z[::every], axis=1))
    steps = steps[np.isfinite(steps) & (steps > 0)]
    return float(np.median(steps)) if len(steps) else _FINEST_PITCH
