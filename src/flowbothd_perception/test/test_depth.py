"""Lenses, and depth images seen through them."""

import numpy as np
import pytest

from flowbothd_common.errors import InvalidCloudError
from flowbothd_perception.depth import Lens, distort, ray_table
from flowbothd_perception.frame import DepthFrame, Optics

KINECT = (2.95, 1.62, -1.1e-4, 3.4e-5, 0.083, 3.28, 2.44, 0.43)
MATRIX = (504.0, 0.0, 320.5, 0.0, 504.2, 330.1, 0.0, 0.0, 1.0)


def points_of(image, lens):
    frame = DepthFrame(image, Optics(ray_table(lens)))
    return frame.points(np.arange(image.size))


def test_a_pinhole_without_distortion():
    lens = Lens(8, 6, (2.0, 0, 3.0, 0, 4.0, 1.0, 0, 0, 1))
    np.testing.assert_allclose(ray_table(lens)[5, 7], ((7 - 3) / 2, (5 - 1) / 4))
    points = points_of(np.full((6, 8), 2.0, np.float32), lens)
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
    right = points_of(flat, Lens(640, 576, MATRIX, KINECT))
    naive = points_of(flat, Lens(640, 576, MATRIX))
    assert np.nanmax(np.linalg.norm(right - naive, axis=1)) > 0.01


def test_a_distorted_picture_of_a_wall_becomes_a_flat_wall():
    """The image a lens makes of a wall one metre away, undone: every point is on the wall."""
    lens = Lens(640, 576, MATRIX, KINECT)
    normal = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
    rays = ray_table(lens).astype(float)
    depth = 1.0 / (rays[..., 0] * normal[0] + rays[..., 1] * normal[1] + normal[2])
    points = points_of(np.nan_to_num(depth).astype(np.float32), lens)
    seen = np.isfinite(points[:, 0])
    np.testing.assert_allclose(points[seen] @ normal, 1.0, atol=1e-5)
    # The same pixels with K alone miss the wall.
    naive = points_of(np.nan_to_num(depth).astype(np.float32), Lens(640, 576, MATRIX))
    assert np.abs(naive[seen] @ normal - 1.0).max() > 0.005


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Lens(4, 4, (0.0,) * 9), r"no calibration.*focal lengths > 0.*never guessed"),
        (lambda: Lens(4, 4, (np.nan,) * 9), r"no calibration.*nan.*finite numbers"),
        (lambda: Lens(0, 4, MATRIX), r"no image size; got 0 x 4; allowed: 1 to 8192"),
        (lambda: Lens(4, 4, MATRIX, (0.1,) * 3), r"3 coefficients; allowed: 0, 4, 5 .*or 8"),
    ],
)
def test_errors_say_what_is_allowed(make, message):
    with pytest.raises(InvalidCloudError, match=message):
        make()
