"""Crop, outliers, sampling and the joint buffer: properties that hold for any cloud."""

import numpy as np
import pytest

from flowbothd_common.errors import ParameterError
from flowbothd_common.transforms import apply, look_at
from flowbothd_perception.crop import inside_box
from flowbothd_perception.frame import CloudFrame
from flowbothd_perception.joint_buffer import JointBuffer
from flowbothd_perception.outliers import beside, inliers, on_surface
from flowbothd_perception.params import CameraParams, CropParams, OutlierParams
from flowbothd_perception.sampling import sample

CAMERA = look_at((0.5, -1.1, 0.7), (0.55, 0, 0.2))


def rows(cloud):
    return {row.tobytes() for row in cloud}


@pytest.mark.parametrize("seed", range(5))
def test_crop_is_the_box_after_the_transform(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(scale=1.0, size=(5000, 3)).astype(np.float32)
    points = points[points[:, 2] > 0]
    inside = CloudFrame(points).inside(CAMERA, CropParams())
    base = apply(CAMERA, points)
    np.testing.assert_array_equal(inside, np.flatnonzero(inside_box(base, CropParams())))
    assert 0 < len(inside) < len(points)


def test_crop_is_idempotent_and_monotone():
    points = np.random.default_rng(0).uniform(-1, 2, (5000, 3)).astype(np.float32)
    once = points[inside_box(points, CropParams())]
    assert inside_box(once, CropParams()).all()
    larger = CropParams(min_corner=(-0.1, -0.7, 0.0), max_corner=(1.4, 0.7, 1.2))
    assert rows(once) <= rows(points[inside_box(points, larger)])
    assert once[:, 2].min() >= np.float32(0.02)


def test_points_that_are_not_finite_are_outside():
    points = np.array([[np.nan, 0, 0.1], [0.5, 0, np.inf], [0.5, 0, 0.1]], np.float32)
    np.testing.assert_array_equal(inside_box(points, CropParams()), [False, False, True])
    np.testing.assert_array_equal(CloudFrame(points).inside(np.eye(4), CropParams()), [2])


def test_an_empty_workspace_is_refused():
    with pytest.raises(ParameterError, match=r"crop.min_corner below crop.max_corner"):
        CropParams(min_corner=(1.0, 0.0, 0.0), max_corner=(0.5, 1.0, 1.0))


def test_a_missing_calibration_is_never_guessed():
    with pytest.raises(ParameterError, match=r"not calibrated.*perception_node.*never guessed"):
        _ = CameraParams().T_base_camera


def test_flying_pixels_go_and_the_surface_stays():
    rng = np.random.default_rng(0)
    wall = np.column_stack([np.full(4000, 0.5), rng.uniform(0, 0.3, (4000, 2))])
    flying = rng.uniform((0.1, 0, 0), (0.45, 0.3, 0.3), (60, 3))
    keep = inliers(np.concatenate([wall, flying]).astype(np.float32), OutlierParams())
    assert keep[:4000].mean() > 0.99
    assert keep[4000:].mean() < 0.05


def test_a_small_clump_goes_a_large_one_stays():
    rng = np.random.default_rng(0)
    parts = [rng.uniform(0, 0.2, (3000, 3)), rng.uniform(0, 0.02, (30, 3)) + 0.6]
    keep = inliers(np.concatenate(parts).astype(np.float32), OutlierParams())
    assert keep[:3000].mean() > 0.95
    assert not keep[3000:].any()


@pytest.mark.parametrize("count", [0, 1, 5, 13])
def test_tiny_clouds_are_kept_whole(count):
    assert inliers(np.zeros((count, 3), np.float32), OutlierParams()).all()


PITCH = 0.002
U, V = np.meshgrid(np.arange(60), np.arange(50))


def surface(depth, params=None):
    pixels = np.arange(depth.size)
    return on_surface(depth, 1.0, pixels, PITCH, params or OutlierParams()).reshape(depth.shape)


@pytest.mark.parametrize("slope", [0.0, 1.0, 3.0, 10.0])
@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, 1.0), (0.6, 0.8)])
def test_a_plane_is_a_surface_however_it_is_seen(slope, direction):
    """Up to 84 degrees off the view; at the image's border some neighbours are missing."""
    along = direction[0] * (U - 30) + direction[1] * (V - 25)
    depth = (1.0 + slope * PITCH * along).astype(np.float32)
    assert surface(depth)[2:-2, 2:-2].all()


def test_pixels_between_two_surfaces_are_on_neither():
    rng = np.random.default_rng(0)
    depth = np.where(U < 30, 1.0, 1.5).astype(np.float32)
    depth[:, 29] = rng.uniform(1.02, 1.48, 50)
    keep = surface(depth)
    assert keep[:, 29].mean() < 0.05
    assert keep[:, :29].all()
    assert keep[:, 30:].all()


def test_thin_rods_are_surfaces_and_single_pixels_are_not():
    depth = np.full((50, 60), np.nan, np.float32)
    depth[:, 20:22] = 1.0
    depth[10, 40] = 1.0
    keep = surface(depth)
    assert keep[:, 20:22].all()
    assert not keep[10, 40]
    assert surface(depth, OutlierParams(min_depth_neighbors=0)).all()


def test_images_smaller_than_a_window_are_kept():
    assert surface(np.ones((4, 60), np.float32)).all()
    assert on_surface(np.ones((9, 9)), 1.0, np.zeros(0, int), PITCH, OutlierParams()).size == 0


def test_what_lies_beside_chosen_points():
    points = np.array([[0, 0, 0], [0.02, 0, 0], [1.0, 0, 0]], np.float32)
    np.testing.assert_array_equal(beside(points, points[:1], 0.03), [True, True, False])
    assert not beside(points, points[:0], 0.03).any()


def test_sampling_is_seeded_and_without_repetition():
    chosen = sample(1000, 100, np.random.default_rng(1))
    assert len(set(chosen.tolist())) == 100
    assert chosen.min() >= 0
    assert chosen.max() < 1000
    np.testing.assert_array_equal(chosen, sample(1000, 100, np.random.default_rng(1)))
    np.testing.assert_array_equal(sample(50, 100, np.random.default_rng(1)), np.arange(50))


def test_joints_are_interpolated_between_states():
    buffer = JointBuffer(("a", "b"))
    buffer.add(1.0, ("b", "x", "a"), (10.0, 0.0, 0.0))
    buffer.add(1.05, ("a", "b"), (1.0, 20.0))
    positions, why = buffer.at(1.025)
    assert why == ""
    np.testing.assert_allclose(positions, (0.5, 15.0))
    assert buffer.reaches(1.05)
    assert not buffer.reaches(1.08)


def test_joints_are_extrapolated_a_little_way_and_no_farther():
    buffer = JointBuffer(("a",), max_extrapolation=0.02)
    buffer.add(1.0, ("a",), (0.0,))
    np.testing.assert_allclose(buffer.at(1.01)[0], [0.0])
    buffer.add(1.01, ("a",), (0.1,))
    np.testing.assert_allclose(buffer.at(1.02)[0], [0.2])
    np.testing.assert_allclose(buffer.at(0.99)[0], [-0.1])
    assert buffer.at(1.04)[0] is None
    assert buffer.at(0.97)[0] is None


@pytest.mark.parametrize(
    ("positions", "why"), [((np.nan,), "not finite"), ((), "1 joint names, but 0 positions")]
)
def test_a_joint_state_that_says_nothing_is_refused(positions, why):
    buffer = JointBuffer(("a",))
    with pytest.raises(ValueError, match=why):
        buffer.add(1.0, ("a",), positions)
    assert buffer.at(1.0)[0] is None


@pytest.mark.parametrize(
    ("stamp", "why"),
    [
        (0.5, "begin 0.500 s after"),
        (1.5, "no joint states for 1.000 s"),
        (2.2, "end 0.200 s before"),
    ],
)
def test_an_image_without_joint_states_is_not_passed_on(stamp, why):
    buffer = JointBuffer(("a",), max_gap=0.1)
    assert buffer.at(1.0) == (None, "no joint states yet")
    buffer.add(1.0, ("a",), (0.0,))
    buffer.add(2.0, ("a",), (1.0,))
    positions, message = buffer.at(stamp)
    assert positions is None
    assert why in message


def test_a_gap_in_which_the_arm_stood_still_does_not_matter():
    """The incident: a busy machine lost half a second of joint states, and every frame with it."""
    buffer = JointBuffer(("a",), max_gap=0.1, stationary_threshold=0.01)
    buffer.add(1.0, ("a",), (0.5,))
    buffer.add(1.6, ("a",), (0.505,))
    np.testing.assert_allclose(buffer.at(1.3)[0], [0.5025])
    buffer.add(2.2, ("a",), (0.6,))
    assert buffer.at(1.9)[0] is None


def test_a_reset_of_time_empties_the_buffer():
    buffer = JointBuffer(("a",))
    buffer.add(100.0, ("a",), (5.0,))
    buffer.add(1.0, ("a",), (0.0,))
    assert buffer.at(100.0)[0] is None
    np.testing.assert_allclose(buffer.at(1.0)[0], [0.0])


def test_the_buffer_stays_small():
    buffer = JointBuffer(("a",), length=10)
    for k in range(1000):
        buffer.add(k * 0.01, ("a",), (float(k),))
    np.testing.assert_allclose(buffer.at(9.985)[0], [998.5])
    assert buffer.at(1.0)[0] is None


def test_a_missing_joint_is_named():
    with pytest.raises(KeyError, match=r"joints missing: \['b'\]; present: \['a'\]"):
        JointBuffer(("a", "b")).add(0.0, ("a",), (0.0,))
