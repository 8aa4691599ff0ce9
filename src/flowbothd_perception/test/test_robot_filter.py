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


@pytest.mark.long
def test_against_the_truth_of_the_sim_camera():
    """The composed arm in random poses before the door: per-pixel labels tell right from wrong."""
    pinocchio = pytest.importorskip("pinocchio")
    camera_module = pytest.importorskip("sim_bridge.camera")
    world_module = pytest.importorskip("sim_bridge.world")
    registry = pytest.importorskip("sim_bridge.objects.registry")
    description = pytest.importorskip("franka_suction_driver.description")
    urdf = description.compose_urdf()
    robot = RobotFilter(urdf, RobotFilterParams())
    model, rng = pinocchio.buildModelFromXML(urdf), np.random.default_rng(0)
    home = np.array([0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4])
    counts = np.zeros(4)
    with world_module.ArmWorld(
        urdf, registry.load_object("custom_door", mode="pull_left")
    ) as world:
        camera = camera_module.DepthCamera(world.parts(), CAMERA)
        poses = world.part_poses()
        for _ in range(10):
            q = home + rng.uniform(-0.7, 0.7, 7)
            data = model.createData()
            pinocchio.framesForwardKinematics(model, data, q)
            for name in [name for name in poses if name.startswith("robot/")]:
                poses[name] = data.oMf[model.getFrameId(name[6:])].homogeneous
            image = camera.render(poses)
            valid = image.depth > 0
            rays = camera.intrinsics.directions()[valid]
            points = apply(CAMERA, (rays * image.depth[valid][:, None]).astype(np.float32))
            is_robot, is_object = image.mask("robot/")[valid], image.mask("object/")[valid]
            found = robot.on_robot(points, q)
            counts += [
                is_robot.sum(),
                (found & is_robot).sum(),
                is_object.sum(),
                (found & is_object).sum(),
            ]
    assert counts[1] / counts[0] > 0.999
    assert counts[3] / counts[2] < 0.005
