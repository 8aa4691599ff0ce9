"""Collision checks against scenes whose answer is known."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from flowbothd_common.errors import InvalidCloudError, ParameterError
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.params import MotionParams
from franka_suction_driver.planning.collision import Box, CollisionChecker, Margins

START = np.array(MotionParams().robot.start_positions)
FOLDED = np.array([0.0, 1.7, 0.0, -3.0, 0.0, 0.0, 0.0])
INTO_TABLE = np.array([0.0, 1.2, 0.0, -1.5, 0.0, 2.7, 0.0])


@pytest.fixture
def checker(robot: Kinematics) -> Iterator[CollisionChecker]:
    yield CollisionChecker(robot, Margins(scene=0.01))


def wall(x: float) -> np.ndarray:
    y, z = np.meshgrid(np.arange(-0.3, 0.3, 0.01), np.arange(0.0, 0.9, 0.01))
    return np.column_stack([np.full(y.size, x), y.ravel(), z.ravel()])


def at(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def test_start_pose_is_free_and_bad_ones_say_what_touches(checker: CollisionChecker) -> None:
    assert checker.touch(START) is None
    touching_table = checker.touch(INTO_TABLE)
    assert touching_table is not None
    assert "table" in str(touching_table)
    folded = CollisionChecker(checker._kinematics, table_height=None)
    assert folded.touch(INTO_TABLE) is None
    itself = folded.touch(FOLDED)
    assert itself is not None
    assert "cloud" not in str(itself)


def test_a_wall_is_felt_from_its_margin_on(checker: CollisionChecker, robot: Kinematics) -> None:
    """The cup's lip points down at x = 0.31; its rim and the tool's body reach 4.5 cm further."""
    reach = float(robot.tip(START).position[0]) + 0.045
    for distance, free in ((0.06, True), (0.03, True), (0.004, False), (-0.02, False)):
        checker.set_points(wall(reach + distance))
        assert checker.free(START) is free, distance
    checker.set_points(None)
    assert checker.free(START)


def test_contact_links_may_touch_the_scene_but_nothing_else(
    checker: CollisionChecker, robot: Kinematics
) -> None:
    tip = robot.tip(START).position
    spot = tip + np.random.default_rng(0).uniform(-0.002, 0.002, (20, 3))
    checker.set_points(spot)
    assert not checker.free(START)
    assert checker.free(START, contact_links=("suction_stem", "suction_cup"))
    assert not checker.free(START)
    assert not checker.free(FOLDED, contact_links=("suction_stem", "suction_cup"))


def test_boxes_can_be_moved(checker: CollisionChecker, robot: Kinematics) -> None:
    tip = robot.tip(START).position
    checker.set_boxes([Box("crate", (0.1, 0.1, 0.1), at(*tip))])
    assert "crate" in str(checker.touch(START))
    checker.move_box("crate", at(1.0, 1.0, 1.0))
    assert checker.free(START)
    checker.set_points(wall(0.9))
    checker.move_box("crate", at(*tip))
    assert not checker.free(START)
    with pytest.raises(ParameterError, match=r"got box.*crate"):
        checker.move_box("box", np.eye(4))


def test_a_failure_within_another_scene_leaves_the_scene_as_it_was(
    checker: CollisionChecker, robot: Kinematics
) -> None:
    """The incident: an exception while planning left the swinging part and a wide margin behind."""
    crate = Box("crate", (0.1, 0.1, 0.1), at(*robot.tip(START).position))
    usual = checker.scene_margin
    with (
        pytest.raises(ParameterError),
        checker.with_boxes([crate]),
        checker.with_scene_margin(0.2),
    ):
        assert checker.scene_margin == 0.2
        assert not checker.free(START)
        checker.move_box("box", np.eye(4))
    assert checker.scene_margin == usual
    assert checker.free(START)


def test_a_margin_outlasts_a_change_of_the_scene(checker: CollisionChecker) -> None:
    """The incident: setting points brought the usual margin back within a wider one."""
    far = Box("crate", (0.1, 0.1, 0.1), at(0.0, 0.9, 0.5))
    with checker.with_boxes([far]):
        assert checker.free(START)
        with checker.with_scene_margin(1.0):
            assert not checker.free(START)
            checker.set_points(None)
            assert not checker.free(START)
        assert checker.free(START)


def test_path_checks_find_the_first_touch(checker: CollisionChecker) -> None:
    path = np.linspace(START, INTO_TABLE, 30)
    free = checker.free_count(path)
    assert 0 < free < 30
    assert not checker.free(path[free])
    assert not checker.edge_free(START, 2 * INTO_TABLE - START, 0.05)
    assert checker.edge_free(START, START + 0.05, 0.01)


def test_bad_input_is_refused(checker: CollisionChecker) -> None:
    with pytest.raises(InvalidCloudError, match="obstacle cloud"):
        checker.set_points(np.full((3, 3), np.nan))
    with pytest.raises(ParameterError, match=r"unknown links.*suction_cup"):
        checker.free(START, contact_links=("hand",))
    checker.set_points(np.empty((0, 3)))
    assert checker.points is None
    assert checker.free(START)
