"""Frames: one scene in every form that a camera driver may send it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.transforms import apply, inverse, look_at, rotation_about, transform
from flowbothd_perception.crop import inside_box, to_base
from flowbothd_perception.depth import Lens, ray_table
from flowbothd_perception.frame import CloudFrame, DepthFrame, Optics
from flowbothd_perception.params import CropParams

LENS = Lens(64, 48, (60.0, 0, 31.5, 0, 60.0, 23.5, 0, 0, 1))
OPTICS = Optics(ray_table(LENS))
BOX = CropParams()
MOUNTS = [
    look_at((0.5, -1.1, 0.7), (0.55, 0, 0.2)),
    look_at((0.5, 1.1, 0.7), (0.55, 0, 0.2)),
    look_at((0.5, -1.1, 0.7), (0.55, 0, 0.2)) @ transform(rotation_about((0, 0, 1), np.pi / 2)),
    look_at((0.6, 0.0, 1.0), (0.6, 0.01, 0.0)),
    look_at((0.6, 0.0, 0.5), (1.0, 0.1, 0.4)),
]
"""Right, mirrored, on its side, looking down, and within the workspace itself."""


def some_depth(seed=0):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.2, 2.5, (48, 64)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = 0
    return depth


def cloud_of(depth, invalid=np.nan):
    points = np.empty((*depth.shape, 3), np.float32)
    points[..., :2] = ray_table(LENS) * depth[..., None]
    points[..., 2] = depth
    points[~(depth > 0)] = invalid
    return points


@pytest.mark.parametrize("mount", range(len(MOUNTS)))
@pytest.mark.parametrize("seed", range(3))
def test_cropping_depths_is_cropping_points(mount, seed):
    T, depth = MOUNTS[mount], some_depth(seed)
    points = cloud_of(depth).reshape(-1, 3).astype(float)
    base = apply(T, points)
    low, high = np.array(BOX.min_corner), np.array(BOX.max_corner)
    with np.errstate(invalid="ignore"):
        surely = np.flatnonzero(((base > low + 1e-5) & (base < high - 1e-5)).all(axis=1))
        perhaps = np.flatnonzero(((base > low - 1e-5) & (base < high + 1e-5)).all(axis=1))
    assert len(surely) > 50
    for frame in (DepthFrame(depth, OPTICS), CloudFrame(cloud_of(depth))):
        inside = frame.inside(T, BOX)
        assert set(surely) <= set(inside) <= set(perhaps)


def test_millimetres_and_metres_agree():
    millimetres = np.rint(1000 * some_depth()).astype(np.uint16)
    metres = millimetres.astype(np.float32) * np.float32(0.001)
    one, other = DepthFrame(millimetres, OPTICS), DepthFrame(metres, OPTICS)
    a, b = one.inside(MOUNTS[0], BOX), other.inside(MOUNTS[0], BOX)
    assert len(np.setxor1d(a, b)) <= 2, "but for points on the very border"
    np.testing.assert_array_equal(one.points(a), other.points(a))
    assert one.measured() == other.measured() == np.count_nonzero(millimetres)


@pytest.mark.parametrize("invalid", [np.nan, 0.0, np.inf, -np.inf])
def test_every_kind_of_invalid_point_is_outside(invalid):
    # The camera itself stands in the workspace: (0, 0, 0) would be a fine point.
    depth = some_depth()
    clean, dirty = CloudFrame(cloud_of(depth)), CloudFrame(cloud_of(depth, invalid))
    expected = clean.inside(MOUNTS[4], BOX)
    np.testing.assert_array_equal(dirty.inside(MOUNTS[4], BOX), expected)
    assert dirty.measured() == clean.measured() == np.count_nonzero(depth)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, -np.inf, 9.0])
def test_no_measurement_is_no_point(value):
    depth = np.full((48, 64), value, np.float32)
    assert len(DepthFrame(depth, OPTICS, 3.0).inside(MOUNTS[0], BOX)) == 0


def test_pixels_without_a_ray_are_outside():
    rays = ray_table(LENS)
    rays[:, :32] = np.nan
    inside = DepthFrame(np.full((48, 64), 1.0, np.float32), Optics(rays)).inside(MOUNTS[0], BOX)
    assert len(inside)
    assert (inside % 64 >= 32).all()


def test_far_measurements_do_not_count():
    depth = some_depth()
    for frame in (DepthFrame(depth, OPTICS, 1.0), CloudFrame(cloud_of(depth), 1.0)):
        inside = frame.inside(MOUNTS[0], BOX)
        assert len(inside)
        assert frame.points(inside)[:, 2].max() <= 1.0


@pytest.mark.parametrize("shape", [(0, 3), (0, 0, 3), (1, 0, 3), (0, 5, 3)])
def test_empty_clouds_are_frames(shape):
    frame = CloudFrame(np.empty(shape, np.float32))
    assert frame.measured() == 0
    assert len(frame.inside(MOUNTS[0], BOX)) == 0
    assert len(frame.grid(np.zeros(0, np.intp))[2]) == 0


FINE = Lens(160, 120, (400.0, 0, 79.5, 0, 400.0, 59.5, 0, 0, 1))


def test_a_thin_cloud_has_no_grid():
    points = np.random.default_rng(0).uniform((-0.5, -0.5, 0.8), (0.5, 0.5, 1.2), (500, 3))
    image, _, where, _ = CloudFrame(points.astype(np.float32)).grid(np.arange(500))
    assert image.shape == (1, 1)
    assert where.shape == (500,)


def test_a_loose_cloud_is_seen_on_a_grid_of_its_own():
    depth = np.where(np.arange(160) < 70, 1.0, 1.4)[None].repeat(120, 0).astype(np.float32)
    frame = DepthFrame(depth, Optics(ray_table(FINE)))
    points = frame.points(np.arange(depth.size))
    shuffled = points[np.random.default_rng(0).permutation(len(points))]
    image, unit, where, pitch = CloudFrame(shuffled).grid(np.arange(len(shuffled)))
    assert unit == 1.0
    assert 0.5 / 400 < pitch < 3 / 400
    near = shuffled[:, 2] < 1.2
    agree = np.isclose(image.ravel()[where], shuffled[:, 2])
    assert agree.mean() > 0.9, "few points share a cell with one of the other surface"
    assert agree[near].mean() > 0.9


@settings(max_examples=40, deadline=None)
@given(
    yaw=st.floats(-3.1, 3.1),
    height=st.floats(0.3, 1.5),
    roll=st.floats(-3.1, 3.1),
    seed=st.integers(0, 1000),
)
def test_turning_camera_and_world_together_changes_nothing(yaw, height, roll, seed):
    """The same points seen from another mount: the same points in base come out."""
    rng = np.random.default_rng(seed)
    base = rng.uniform((-0.2, -0.8, -0.1), (1.5, 0.8, 1.3), (300, 3))
    eye = np.array([0.5 + 1.4 * np.cos(yaw), 1.4 * np.sin(yaw), height])
    T = look_at(eye, (0.5, 0, 0.3)) @ transform(rotation_about((0, 0, 1), roll))
    seen = apply(inverse(T), base).astype(np.float32)
    front = seen[:, 2] > 0
    frame = CloudFrame(seen[front])
    inside = frame.inside(T, BOX)
    border = np.abs(base[front][:, :, None] - np.array([BOX.min_corner, BOX.max_corner]).T).min(2)
    clear = border.min(axis=1) > 1e-4
    expected = inside_box(base[front].astype(np.float32), BOX)
    found = np.zeros(len(expected), bool)
    found[inside] = True
    np.testing.assert_array_equal(found[clear], expected[clear])
    np.testing.assert_allclose(to_base(T, frame.points(inside)), base[front][inside], atol=1e-5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DepthFrame(np.zeros((48, 64), np.int32), OPTICS), "int32; allowed: uint16"),
        (lambda: DepthFrame(np.zeros((2, 2), np.uint16), OPTICS), r"\(2, 2\), \(48, 64\)"),
        (lambda: DepthFrame(np.zeros((48, 64, 1), np.uint16), OPTICS), r"differ in size"),
        (lambda: CloudFrame(np.zeros((4, 4), np.float32)), r"\(4, 4\); allowed: \(H, W, 3\)"),
        (lambda: CloudFrame(np.zeros(3, np.float32)), r"wrong shape"),
    ],
)
def test_errors_say_what_is_allowed(make, message):
    with pytest.raises(InvalidCloudError, match=message):
        make()
