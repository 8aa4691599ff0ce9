"""The depth camera against analytic truth, and what it remembers between frames."""

import numpy as np
import pytest

from flowbothd_common.errors import FlowBotError
from flowbothd_common.transforms import look_at, rotation_from_rpy, transform
from sim_bridge.camera import DepthCamera, Intrinsics
from sim_bridge.depth_noise import DepthNoise, disturb
from sim_bridge.mesh import Mesh, box_mesh, sphere_mesh
from sim_bridge.objects import load_object
from sim_bridge.objects.custom_door import MODES
from sim_bridge.render import render_rgb
from sim_bridge.scene import Part

SMALL = Intrinsics(160, 144, 126.0, 126.0, 79.5, 71.5, near=0.1, far=5.0)
EYE = look_at((-1.0, 0.2, 0.8), (0.0, 0.0, 0.1))
WALL = Part(
    "wall",
    (
        Mesh(
            np.array([[0.0, -9, -9], [0, 9, -9], [0, 9, 9], [0, -9, 9]]),
            np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
        ),
    ),
)


def test_depth_of_a_plane_is_exact_in_every_pixel():
    """Catches a pixel offset: half a pixel is 1.2 mm on an inclined surface."""
    camera = DepthCamera([WALL], EYE, SMALL)
    image = camera.render({"wall": np.eye(4)})
    u, v = np.meshgrid(np.arange(SMALL.width), np.arange(SMALL.height))
    ray = np.stack([(u - SMALL.cx) / SMALL.fx, (v - SMALL.cy) / SMALL.fy, np.ones_like(u)], -1)
    in_base = ray @ EYE[:3, :3].T
    with np.errstate(divide="ignore"):
        depth = -EYE[0, 3] / in_base[..., 0]
    seen = (depth > SMALL.near) & (depth < SMALL.far)
    assert np.array_equal(image.depth > 0, seen)
    assert np.abs(image.depth[seen] - depth[seen]).max() < 1e-5


def test_the_cloud_lies_on_the_surface():
    ball = Part("ball", (sphere_mesh(0.2),))
    middle = np.array([0.1, -0.05, 0.15])
    camera = DepthCamera([ball], EYE, SMALL)
    cloud = camera.cloud(camera.render({"ball": transform(translation=middle)}))
    assert len(cloud) > 300
    radius = np.linalg.norm(cloud - middle, axis=1)
    # The ball is a polyhedron that lies up to two millimetres within the sphere.
    assert radius.max() < 0.2 + 1e-5
    assert radius.min() > 0.197


def test_only_what_is_nearest_is_seen_and_labelled():
    near = Part("near", (box_mesh((0.2, 0.2, 0.2)),))
    camera = DepthCamera([WALL, near], EYE, SMALL)
    image = camera.render({"wall": np.eye(4), "near": transform(translation=(-0.4, 0.1, 0.35))})
    alone = camera.render({"wall": np.eye(4)})
    hides = image.mask("near")
    assert 0 < hides.sum() < image.depth.size / 2
    assert (image.depth[hides] < alone.depth[hides]).all()
    assert np.array_equal(image.depth[~hides], alone.depth[~hides])
    assert not alone.mask("near").any()


def test_moved_parts_are_seen_where_they_are_as_by_a_new_camera(rng):
    """Incident to prevent: a remembered part that has moved is shown at its old place."""
    parts = [Part(f"box{i}", (box_mesh((0.1, 0.2, 0.15)),)) for i in range(3)]
    camera = DepthCamera(parts, EYE, SMALL)
    for _ in range(4):
        poses = {
            part.name: transform(
                rotation_from_rpy(rng.uniform(-2, 2, 3)), rng.uniform(-0.3, 0.3, 3)
            )
            for part in parts
        }
        poses["box0"] = np.eye(4)
        image, fresh = camera.render(poses), DepthCamera(parts, EYE, SMALL).render(poses)
        assert np.array_equal(image.depth, fresh.depth)
        assert np.array_equal(image.labels, fresh.labels)


def test_parts_around_and_behind_the_camera_are_handled():
    around = Part("around", (box_mesh((4.0, 4.0, 4.0)),))
    behind = Part("behind", (box_mesh((0.2, 0.2, 0.2)),))
    camera = DepthCamera([around, behind], EYE, SMALL)
    image = camera.render({"around": np.eye(4), "behind": transform(translation=(-2, 0.3, 1.5))})
    assert (image.depth > 0).all()
    assert not image.mask("behind").any()


def test_millimetres_and_range():
    camera = DepthCamera([WALL], EYE, Intrinsics(160, 144, 126, 126, 79.5, 71.5, 0.5, 1.3))
    image = camera.render({"wall": np.eye(4)})
    measured = image.depth[image.depth > 0]
    assert measured.min() >= 0.5
    assert measured.max() <= 1.3
    millimetres = image.millimetres()
    assert millimetres.dtype == np.uint16
    assert np.array_equal(millimetres == 0, image.depth == 0)
    assert np.abs(millimetres[millimetres > 0] / 1000 - measured).max() <= 0.00051


def test_an_exposure_in_pieces_is_the_same_picture():
    parts = [WALL, Part("ball", (sphere_mesh(0.2),))]
    poses = {"wall": np.eye(4), "ball": transform(translation=(-0.2, 0, 0.1))}
    camera = DepthCamera(parts, EYE, SMALL)
    pieces = camera.exposing(poses)
    count = 0
    try:
        while True:
            next(pieces)
            count += 1
    except StopIteration as done:
        image = done.value
    assert count == len(parts)
    assert np.array_equal(image.depth, camera.render(poses).depth)


def test_noise_is_seeded_and_as_large_as_told():
    noise = DepthNoise(sigma=0.002, sigma_per_m2=0.0)
    exact = DepthCamera([WALL], EYE, SMALL).render({"wall": np.eye(4)}).depth
    first, again, other = (
        DepthCamera([WALL], EYE, SMALL, noise, seed).render({"wall": np.eye(4)}).depth
        for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    error = (first - exact)[(exact > 0.2) & (exact < 4.9)]
    assert error.std() == pytest.approx(0.002, rel=0.05)
    assert abs(error.mean()) < 1e-4


def test_flying_pixels_fly_between_two_surfaces(rng):
    depth = np.full((40, 40), 2.0, dtype=np.float32)
    depth[10:30, 10:30] = 1.0
    noise = DepthNoise(sigma=0.0, sigma_per_m2=0.0, flying_fraction=1.0)
    flown = disturb(depth, noise, rng)
    moved = flown != depth
    assert 60 < moved.sum() <= 76, "the rim of the near square"
    assert ((flown[moved] > 1.0) & (flown[moved] < 2.0)).all()
    assert np.array_equal(disturb(depth, DepthNoise(0.0, 0.0, 0.0), rng), depth)


def test_the_four_closed_doors_look_alike_to_the_last_bit():
    images = []
    for mode in MODES:
        model = load_object("custom_door", mode=mode)
        parts = [Part(f"object/{name}", link.meshes) for name, link in model.links.items()]
        camera = DepthCamera(parts, look_at((0.55, -1.1, 0.65), (0.55, 0, 0.22)))
        moved = model.displacements(model.closed()).items()
        images.append(camera.render({f"object/{n}": model.default_pose @ m for n, m in moved}))
    for image in images[1:]:
        assert np.array_equal(image.depth, images[0].depth)
        assert np.array_equal(image.labels, images[0].labels)


def test_impossible_lenses_are_refused():
    with pytest.raises(FlowBotError, match="0 x 10"):
        Intrinsics(width=0, height=10)


def test_a_picture_for_people_shows_parts_in_their_colours():
    red = Part("red", (box_mesh((0.4, 0.4, 0.4), (0.9, 0.1, 0.1)),))
    picture = render_rgb([red], {"red": np.eye(4)}, (-1, -1, 1), (0, 0, 0), (120, 90))
    assert picture.shape == (90, 120, 3)
    assert picture.dtype == np.uint8
    centre, corner = picture[45, 60].astype(int), picture[2, 2].astype(int)
    assert centre[0] > 2 * centre[1]
    assert corner.min() > 200, "sky"
    empty = render_rgb([red], {}, (-1, -1, 1), (0, 0, 0), (120, 90))
    assert empty.min() > 200
