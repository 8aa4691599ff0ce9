"""Depth images and clouds to points."""

import numpy as np
import pytest

from flowbothd_common.errors import InvalidCloudError
from flowbothd_perception.cloud import valid_points
from flowbothd_perception.depth import Lens, depth_in_metres, distort, points_from_depth, ray_table

KINECT = (2.95, 1.62, -1.1e-4, 3.4e-5, 0.083, 3.28, 2.44, 0.43)
MATRIX = (504.0, 0.0, 320.5, 0.0, 504.2, 330.1, 0.0, 0.0, 1.0)


def test_a_pinhole_without_distortion():
    rays = ray_table(Lens(8, 6, (2.0, 0, 3.0, 0, 4.0, 1.0, 0, 0, 1)))
    np.testing.assert_allclose(rays[5, 7], ((7 - 3) / 2, (5 - 1) / 4))
    points = points_from_depth(np.full((6, 8), 2.0, np.float32), rays)
    np.testing.assert_allclose(points[-1], (4.0, 2.0, 2.0))


@pytest.mark.parametrize(
    "coefficients", [KINECT, (0.1, -0.05, 1e-3, -5e-4), (0.1, -0.2, 0, 0, 0.05)]
)
def test_distortion_is_inverted(coefficients):
    lens = Lens(640, 576, MATRIX, coefficients)
    rays = ray_table(lens).astype(float)
    fine = np.isfinite(rays[..., 0])
    assert fine.mean() > 0.9
    assert fine[200:400, 200:450].all()
    u, v = np.meshgrid(np.arange(640), np.arange(576))
    ideal = np.stack([(u - MATRIX[2]) / MATRIX[0], (v - MATRIX[5]) / MATRIX[4]], axis=-1)
    again = distort(rays, coefficients)
    assert np.abs(again - ideal)[fine].max() * 504 < 0.2


def test_ignoring_distortion_would_be_wrong_by_centimetres():
    flat = np.full((576, 640), 1.0, np.float32)
    right = points_from_depth(flat, np.nan_to_num(ray_table(Lens(640, 576, MATRIX, KINECT))))
    naive = points_from_depth(flat, ray_table(Lens(640, 576, MATRIX)))
    assert np.linalg.norm(right - naive, axis=1).max() > 0.01


def test_invalid_depths_are_dropped():
    rays = ray_table(Lens(3, 2, (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1)))
    depth = np.array([[0, -1, np.nan], [np.inf, 2.0, 9.0]], np.float32)
    np.testing.assert_allclose(points_from_depth(depth, rays, 3.0), [[2.0, 2.0, 2.0]])


def test_units_of_both_encodings():
    millimetres = np.array([[1500]], np.uint16)
    assert depth_in_metres(millimetres)[0, 0] == pytest.approx(1.5)
    metres = np.array([[1.5]], np.float32)
    assert depth_in_metres(metres)[0, 0] == 1.5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Lens(4, 4, (0.0,) * 9), r"no calibration.*focal lengths > 0.*never guessed"),
        (lambda: Lens(4, 4, MATRIX, (0.1,) * 3), r"3 coefficients; allowed: 0, 4, 5 .*or 8"),
        (lambda: depth_in_metres(np.zeros((2, 2), np.int32)), r"int32; allowed: uint16.*float32"),
        (
            lambda: depth_in_metres(np.zeros((2, 2, 1), np.uint16)),
            r"\(2, 2, 1\); allowed: \(H, W\)",
        ),
        (
            lambda: points_from_depth(
                np.zeros((2, 2), np.float32), np.zeros((3, 2, 2), np.float32)
            ),
            r"differ in size.*\(2, 2\), \(3, 2\)",
        ),
        (lambda: valid_points(np.zeros((4, 4), np.float32)), r"\(4, 4\); allowed: \(\.\.\., 3\)"),
    ],
)
def test_errors_say_what_is_allowed(make, message):
    with pytest.raises(InvalidCloudError, match=message):
        make()


@pytest.mark.parametrize("shape", [(4, 1, 3), (2, 2, 3), (4, 3)])
def test_every_kind_of_invalid_point_is_dropped(shape):
    values = np.array([[np.nan] * 3, [0, 0, 0], [0.1, 0.2, 1.0], [0, np.inf, 1]], np.float32)
    np.testing.assert_array_equal(valid_points(values.reshape(shape)), values[2:3])


def test_empty_clouds_stay_empty():
    assert valid_points(np.empty((0, 3), np.float32)).shape == (0, 3)
    assert valid_points(np.full((3, 5, 3), np.nan, np.float32)).shape == (0, 3)
