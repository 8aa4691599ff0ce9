"""Robot filter and pipeline, on a small robot of every shape and against the sim camera."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from flowbothd_common.errors import ObjectModelError, ParameterError
from flowbothd_common.transforms import apply, inverse, look_at
from flowbothd_perception.crop import to_base
from flowbothd_perception.params import PipelineParams, RobotFilterParams, SamplingParams
from flowbothd_perception.pipeline import PerceptionPipeline
from flowbothd_perception.robot_filter import RobotFilter
from flowbothd_perception.solids import Hull

PLAIN = RobotFilterParams(padding=0.02, padded_links=(), paddings=())
LINK = (
    '<link name="{0}"><collision><origin xyz="{1}" rpy="{2}"/>'
    "<geometry>{3}</geometry></collision></link>"
)
URDF = (
    '<robot name="toy">'
    + LINK.format("base", "0 0 0.1", "0 0 0", '<box size="0.2 0.2 0.2"/>')
    + LINK.format("arm", "0 0 0.2", "0 0 0", '<cylinder radius="0.05" length="0.4"/>')
    + LINK.format("ball", "0 0 0", "0 0 0", '<sphere radius="0.06"/>')
    + '<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>'
    '<origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    '<joint name="fixed" type="fixed"><parent link="arm"/><child link="ball"/>'
    '<origin xyz="0 0 0.4"/></joint></robot>'
)


def test_each_shape_is_found_where_the_joint_puts_it():
    robot = RobotFilter(URDF, PLAIN)
    assert robot.joint_names == ("turn",)
    points = np.array(
        [
            [0.0, 0.0, 0.1],  # box
            [0.119, 0.0, 0.1],  # its padding
            [0.121, 0.0, 0.1],
            [0.0, 0.0, 0.5],  # cylinder, upright
            [0.3, 0.0, 0.2],  # cylinder, turned by a quarter
            [0.475, 0.0, 0.2],  # ball, turned
            [0.485, 0.0, 0.2],
        ],
        np.float32,
    )
    np.testing.assert_array_equal(robot.on_robot(points, [0.0]), [1, 1, 0, 1, 0, 0, 0])
    np.testing.assert_array_equal(robot.on_robot(points, [np.pi / 2]), [1, 1, 0, 0, 1, 1, 0])


@pytest.mark.parametrize("seed", range(3))
def test_padding_is_monotone_and_filtering_idempotent(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.8, 0.8, (4000, 3)).astype(np.float32)
    q = rng.uniform(-2, 2, 1)
    found = [
        RobotFilter(URDF, replace(PLAIN, padding=p)).on_robot(points, q) for p in (0, 0.02, 0.05)
    ]
    for smaller, larger in pairwise(found):
        assert not (smaller & ~larger).any()
        assert larger.sum() > smaller.sum()
    left = points[~found[1]]
    assert not RobotFilter(URDF, PLAIN).on_robot(left, q).any()


def test_links_may_be_ignored_or_padded_by_name():
    point = np.array([[0.0, 0.0, 0.66]], np.float32)
    assert RobotFilter(URDF, PLAIN).on_robot(point, [0.0])
    assert not RobotFilter(URDF, replace(PLAIN, ignored_links=("ball",))).on_robot(point, [0.0])[0]
    own = RobotFilterParams(padding=0.02, padded_links=("ball", "arm"), paddings=(0.0, 0.0))
    far = np.array([[0.0, 0.0, 0.67]], np.float32)
    assert RobotFilter(URDF, PLAIN).on_robot(far, [0.0])
    assert not RobotFilter(URDF, own).on_robot(far, [0.0])[0]


def test_errors_name_what_is_wrong():
    with pytest.raises(ParameterError, match=r"unknown links.*\['elbow'\].*arm"):
        RobotFilter(URDF, replace(PLAIN, ignored_links=("elbow",)))
    with pytest.raises(ObjectModelError, match="absolute mesh paths"):
        RobotFilter("<robot", PLAIN)
    with pytest.raises(ParameterError, match="one for each of turn"):
        RobotFilter(URDF, PLAIN).on_robot(np.zeros((1, 3), np.float32), [0.0, 0.0])
    with pytest.raises(ParameterError, match="differ in length"):
        RobotFilterParams(padded_links=("a",), paddings=())


@pytest.fixture
def pipeline():
    return PerceptionPipeline(PipelineParams(robot=PLAIN, sampling=SamplingParams(300)), URDF)


CAMERA = look_at((0.5, -1.1, 0.7), (0.55, 0, 0.2))


def seen(points):
    return apply(inverse(CAMERA), points.astype(np.float32))


def test_the_object_survives_and_the_table_and_robot_do_not(pipeline):
    rng = np.random.default_rng(0)
    thing = np.column_stack(
        [np.full(2000, 0.6), rng.uniform(-0.2, 0.2, 2000), rng.uniform(0.05, 0.4, 2000)]
    )
    table = np.column_stack([rng.uniform(0, 1.2, (2000, 2)), rng.normal(scale=0.003, size=2000)])
    arm = rng.uniform((0.1, -0.04, 0.17), (0.38, 0.04, 0.23), (1000, 3))
    frame = seen(np.concatenate([thing, table, arm]))
    result = pipeline.process(frame, CAMERA, [np.pi / 2], seed=3)
    assert result.points.shape == (300, 3)
    assert result.points.dtype == np.float32
    np.testing.assert_allclose(result.points[:, 0], 0.6, atol=1e-4)
    assert list(result.counts) == [
        "measured",
        "workspace",
        "drawn",
        "robot",
        "surface",
        "outliers",
        "sampled",
    ]
    np.testing.assert_array_equal(result.points, to_base(CAMERA, frame[result.pixels]))
    assert result.counts["measured"] == 5000
    assert result.message == ""
    again = pipeline.process(frame, CAMERA, [np.pi / 2], seed=3)
    np.testing.assert_array_equal(result.points, again.points)
    other = pipeline.process(frame, CAMERA, [np.pi / 2], seed=(3, 4))
    assert not np.array_equal(result.points, other.points)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.empty((0, 3)), "measured nothing"),
        (np.full((50, 3), np.nan), "measured nothing"),
        (np.full((50, 3), 5.0), "lies in the workspace"),
        (np.full((50, 3), 9.0), "check camera.position"),
        (np.tile([[0.05, 0.0, 0.1]], (50, 1)), "only the robot"),
        (np.tile([[0.6, 0.0, 0.3]], (50, 1)), "only 50 of 300"),
        (np.array([[0.6, 0.0, 0.3]]), "only 1 of 300"),
    ],
)
def test_odd_frames_have_a_defined_result(pipeline, points, message):
    result = pipeline.process(seen(points), CAMERA, [0.0])
    assert message in result.message
    assert np.isfinite(result.points).all()
    assert result.points.shape[1] == 3


def test_scaled_links_and_shadows_of_every_shape():
    """A cylinder that is twice as large, and points that the robot hides from the camera."""
    beside = np.array([[0.08, 0.0, 0.45]], np.float32)
    assert not RobotFilter(URDF, PLAIN).on_robot(beside, [0.0])[0]
    large = replace(PLAIN, padded_links=("arm",), paddings=(0.0,), scales=(2.0,))
    assert RobotFilter(URDF, large).on_robot(beside, [0.0])[0]
    with pytest.raises(ParameterError, match="scales differ in length"):
        RobotFilterParams(scales=(1.0,))
    eye = np.array([-1.0, 0.0, 0.3])
    behind = np.array([[1.0, 0.0, 0.1], [1.0, 0.0, 0.5], [1.0, 0.0, 0.85]], np.float32)
    lit = np.array([[1.0, 0.5, 0.1], [-0.5, 0.0, 0.3], [1.0, 0.0, 1.6]], np.float32)
    shaded = RobotFilter(URDF, replace(PLAIN, shadow=True))
    np.testing.assert_array_equal(shaded.on_robot(behind, [0.0], eye), [True] * 3)
    assert not shaded.on_robot(lit, [0.0], eye).any()
    assert not shaded.on_robot(behind, [0.0]).any(), "without an eye there is no shadow"
    assert not RobotFilter(URDF, PLAIN).on_robot(behind, [0.0], eye).any()


@pytest.mark.parametrize("seed", range(3))
def test_shadows_are_what_sampling_along_the_ray_finds(seed):
    rng = np.random.default_rng(seed)
    robot = RobotFilter(URDF, replace(PLAIN, padding=0.0, shadow=True))
    eye, q = np.array([-0.9, 0.6, 0.8]), rng.uniform(-1, 1, 1)
    points = rng.uniform((0.0, -0.6, 0.0), (1.0, 0.6, 0.9), (300, 3)).astype(np.float32)
    steps = np.linspace(0, 1, 400)[:, None, None]
    along = (eye + steps * (points - eye)).astype(np.float32).reshape(-1, 3)
    bare = RobotFilter(URDF, replace(PLAIN, padding=0.0))
    blocked = bare.on_robot(along, q).reshape(400, -1).any(axis=0)
    found = robot.on_robot(points, q, eye)
    assert (found != blocked).mean() < 0.02, "but for rays that graze an edge"
    assert not (blocked & ~found).any()


def test_distances_are_those_to_the_surface():
    robot = RobotFilter(URDF, replace(PLAIN, padding=0.0))
    points = np.array([[0.2, 0.0, 0.05], [0.1, 0.0, 0.45], [0.0, 0.0, 0.7]], np.float32)
    distance, part = robot.distances(points, [0.0])
    np.testing.assert_allclose(distance, [0.1, 0.05, 0.04], atol=1e-6)
    assert [robot.links[i] for i in part] == ["base", "arm", "ball"]
    only, _ = robot.distances(points, [0.0], frozenset({"ball"}))
    assert (only >= distance).all()


@pytest.mark.parametrize("seed", range(3))
def test_the_lookup_grid_answers_as_the_faces_do(seed):
    rng = np.random.default_rng(seed)
    hull = Hull(rng.normal(size=(40, 3)) * (0.1, 0.05, 0.2), 0.01)
    points = rng.normal(scale=0.15, size=(20000, 3)).astype(np.float32)
    exact = (points @ hull.planes[:, :3].T + hull.planes[:, 3] <= 0).all(axis=1)
    np.testing.assert_array_equal(hull.contains(points), exact)
    assert 100 < exact.sum() < 15000


@pytest.mark.parametrize("count", [0, 1, 511, 512, 513, 2000])
def test_many_points_have_the_distances_that_each_has_alone(count):
    rng = np.random.default_rng(count)
    hull = Hull(rng.normal(size=(40, 3)) * (0.1, 0.05, 0.2), 0.01)
    points = rng.normal(scale=0.15, size=(count, 3)).astype(np.float32)
    exact = (points[:, None] * hull.planes[:, :3]).sum(axis=2) + hull.planes[:, 3]
    found = hull.distance(points)
    assert found.shape == (count,)
    np.testing.assert_allclose(found, exact.max(axis=1), atol=1e-6)
    np.testing.assert_array_equal(found[exact.max(axis=1) > 1e-6] > 0, True)
