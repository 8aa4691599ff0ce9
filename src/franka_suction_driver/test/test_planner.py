"""Approach and retreat around a door that stands edge-on to the arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from flowbothd_common.motion import MotionReason
from flowbothd_common.transforms import angle_between, apply
from flowbothd_common.types import JointEstimate, JointKind
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.params import MotionParams
from franka_suction_driver.planning.collision import CollisionChecker, Margins
from franka_suction_driver.planning.departure import TOOL_LINKS
from franka_suction_driver.planning.opening_path import (
    PlateExtent,
    displacement,
    moving_part,
    opening_poses,
    plate_extent,
)
from franka_suction_driver.planning.planner import PlannedMotion, Planner

START = np.array(MotionParams().robot.start_positions)
CONTACT = np.array([0.36, 0.09, 0.25])
FRONT, BACK = np.array([0, -1.0, 0]), np.array([0, 1.0, 0])


def door() -> np.ndarray:
    """Points of a plate 20 cm wide, 40 cm high and 2 cm thick in the plane y = 0.1."""
    x, z = np.meshgrid(np.arange(0.26, 0.46, 0.008), np.arange(0.03, 0.43, 0.008))
    faces = [np.column_stack([x.ravel(), np.full(x.size, y), z.ravel()]) for y in (0.09, 0.11)]
    return np.concatenate(faces)


@pytest.fixture
def make_planner(robot: Kinematics, limits: JointLimits) -> Callable[..., Planner]:
    def make(**planning: object) -> Planner:
        params = MotionParams()
        params = replace(params, planning=replace(params.planning, **planning))
        planner = Planner(robot, limits, params)
        planner.collision.set_points(door())
        return planner

    return make


def approach(planner: Planner, direction: np.ndarray, contact: np.ndarray) -> PlannedMotion:
    return planner.approach(START, contact, direction, None, np.random.default_rng(0))


@pytest.mark.parametrize("direction", [FRONT, BACK], ids=["front", "back"])
def test_both_faces_are_approached_without_touching(
    make_planner: Callable[..., Planner],
    robot: Kinematics,
    limits: JointLimits,
    direction: np.ndarray,
) -> None:
    planned = approach(make_planner(), direction, CONTACT)
    assert planned.reason is MotionReason.REACHED, planned.message
    assert planned.side == 1
    trajectory = planned.trajectory
    assert trajectory is not None
    assert limits.violation(trajectory) is None
    tip = robot.tip(trajectory.positions[-1])
    np.testing.assert_allclose(tip.position, CONTACT + 0.1 * direction, atol=1e-3)
    assert angle_between(tip.axis, -direction) < 1e-3
    checker = CollisionChecker(robot, Margins(scene=0.005), cell=0.01)
    checker.set_points(door())
    assert checker.free_count(trajectory.positions) == len(trajectory.positions)


def test_equal_seeds_plan_equal_motions(make_planner: Callable[..., Planner]) -> None:
    first = approach(make_planner(), BACK, CONTACT)
    second = approach(make_planner(), BACK, CONTACT)
    assert first.trajectory is not None
    assert second.trajectory is not None
    np.testing.assert_array_equal(first.trajectory.positions, second.trajectory.positions)


def test_retreat_backs_off_along_the_tool_first(
    make_planner: Callable[..., Planner], robot: Kinematics
) -> None:
    planner = make_planner()
    there = approach(planner, BACK, CONTACT)
    assert there.trajectory is not None
    standoff = there.trajectory.positions[-1]
    home = planner.retreat(standoff, np.random.default_rng(1))
    assert home.reason is MotionReason.REACHED
    assert home.trajectory is not None
    np.testing.assert_allclose(home.trajectory.positions[-1], START, atol=1e-6)
    axis = robot.tip(standoff).axis
    tips = robot.tip(home.trajectory.positions).position - robot.tip(standoff).position
    early = tips[np.linalg.norm(tips, axis=1) < 0.03]
    assert (early @ axis <= 1e-6).all()


def test_out_of_reach_says_where_and_what_helps(make_planner: Callable[..., Planner]) -> None:
    planned = approach(make_planner(), FRONT, np.array([1.4, 0.0, 0.3]))
    assert planned.reason is MotionReason.UNREACHABLE
    assert "1.4" in planned.message
    assert "nearer" in planned.message
    assert "opposite side" in planned.message


def test_a_blocked_contact_names_what_touches(make_planner: Callable[..., Planner]) -> None:
    planner = make_planner(push_from_front=False)
    block = np.random.default_rng(0).uniform(-0.06, 0.06, (4000, 3))
    block += CONTACT + 0.12 * FRONT
    planner.collision.set_points(np.concatenate([door(), block]))
    planned = approach(planner, FRONT, CONTACT)
    assert planned.reason is MotionReason.COLLISION
    assert "cloud" in planned.message


def test_the_opposite_side_is_taken_where_the_flow_side_is_closed(
    make_planner: Callable[..., Planner], robot: Kinematics
) -> None:
    planner = make_planner(lookahead=0.05)
    x, z = np.meshgrid(np.arange(0.2, 0.6, 0.01), np.arange(0.03, 0.7, 0.01))
    screen = np.column_stack([x.ravel(), np.full(x.size, 0.17), z.ravel()])
    planner.collision.set_points(np.concatenate([door(), screen]))
    planned = approach(planner, BACK, CONTACT)
    assert planned.reason is MotionReason.REACHED, planned.message
    assert planned.side == -1
    assert "opposite side" in planned.message
    assert planned.trajectory is not None
    tip = robot.tip(planned.trajectory.positions[-1])
    assert angle_between(tip.axis, BACK) < 1e-3


def test_a_tilted_tool_reaches_where_the_straight_one_cannot(
    make_planner: Callable[..., Planner], robot: Kinematics
) -> None:
    """The incident: a door opened to sixty degrees could not be grasped again."""
    contact, direction = np.array([0.365, -0.043, 0.22]), np.array([0.96, -0.28, 0.0])
    direction /= np.linalg.norm(direction)
    tilts = []
    for slack in (0.0, 0.26):
        planner = make_planner(tilt_slack=slack, lookahead=0.0, push_from_front=False)
        planner.collision.set_points(None)
        planned = approach(planner, direction, contact)
        if planned.trajectory is None:
            tilts.append(None)
            continue
        tip = robot.tip(planned.trajectory.positions[-1])
        np.testing.assert_allclose(tip.position, contact + 0.1 * direction, atol=1e-3)
        tilts.append(angle_between(tip.axis, -direction))
    assert tilts[0] is None
    assert tilts[1] == pytest.approx(0.26, abs=1e-3)


def test_opening_poses_follow_the_arc_and_the_flow_tells_its_sense() -> None:
    contact, direction = np.array([0.5, 0.0, 0.3]), np.array([-1.0, 0, 0])
    for axis in (np.array([0, 0, 1.0]), np.array([0, 0, -1.0])):
        joint = JointEstimate(JointKind.REVOLUTE, axis, np.array([0.5, 0.2, 0.0]))
        poses = opening_poses(contact, direction, 1, 0.1, 0.2 * np.pi / 2, joint)
        np.testing.assert_allclose(poses.positions[0], contact + 0.1 * direction, atol=1e-12)
        np.testing.assert_allclose(poses.positions[poses.contact], contact, atol=1e-12)
        np.testing.assert_allclose(poses.positions[-1], [0.3, 0.2, 0.3], atol=1e-9)
        np.testing.assert_allclose(poses.axes[-1], [0, -1, 0], atol=1e-9)
        radii = np.linalg.norm(poses.positions[poses.contact :, :2] - joint.point[:2], axis=1)
        np.testing.assert_allclose(radii, 0.2, atol=1e-9)


def test_the_moving_part_spans_axis_and_contact_and_leaves_the_tool_room() -> None:
    contact, direction = np.array([0.5, 0.0, 0.3]), np.array([-1.0, 0, 0])
    joint = JointEstimate(JointKind.REVOLUTE, np.array([0, 0, 1.0]), np.array([0.5, 0.2, 0.0]))
    part = moving_part(contact, direction, 1, joint, PlateExtent())
    assert part is not None
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    points = apply(part.pose, corners * np.array(part.size) / 2)
    assert points[:, 0].min() == pytest.approx(0.5)
    assert points[:, 1].max() == pytest.approx(0.2)
    assert points[:, 1].min() < 0.0
    moved = displacement(contact, direction, joint, 0.2 * np.pi / 2)
    np.testing.assert_allclose(apply(moved, contact), [0.3, 0.2, 0.3], atol=1e-9)
    assert moving_part(contact, direction, 1, None, PlateExtent()) is None


def test_a_part_may_be_pushed_although_it_could_be_pulled(
    make_planner: Callable[..., Planner], robot: Kinematics
) -> None:
    planned = approach(make_planner(pull=False, lookahead=0.05), BACK, CONTACT)
    assert planned.reason is MotionReason.REACHED, planned.message
    assert planned.side == -1
    assert planned.trajectory is not None
    np.testing.assert_allclose(
        robot.tip(planned.trajectory.positions[-1]).position, CONTACT + 0.1 * FRONT, atol=1e-3
    )


def test_a_plate_reaches_as_far_as_its_points_hang_together() -> None:
    """Beyond a gap begins another thing, such as the frame."""
    joint = JointEstimate(JointKind.REVOLUTE, np.array([0, 0, 1.0]), np.array([0.26, 0.09, 0.0]))
    points = door()
    beside = points + np.array([0.26, 0.0, 0.0])
    extent = plate_extent(CONTACT, FRONT, joint, np.concatenate([points, beside]))
    assert extent.beyond == pytest.approx(points[:, 0].max() - CONTACT[0], abs=1e-6)
    assert extent.low == pytest.approx(0.03 - CONTACT[2], abs=1e-6)
    assert extent.high == pytest.approx(points[:, 2].max() - CONTACT[2], abs=1e-6)


def test_the_arm_keeps_clear_of_the_part_that_it_leaves(
    make_planner: Callable[..., Planner], robot: Kinematics
) -> None:
    """The incident: the arm hid the leaf from the camera, and pushed it shut with 264 N."""
    planner = make_planner(lookahead=0.05)
    joint = JointEstimate(JointKind.REVOLUTE, np.array([0, 0, 1.0]), np.array([0.26, 0.1, 0.0]))
    there = planner.approach(START, CONTACT, BACK, joint, np.random.default_rng(0))
    assert there.trajectory is not None
    standoff = there.trajectory.positions[-1]
    tip = robot.tip(standoff)
    planner.collision.set_points(None)
    # The leaf has come to where the tool stands, between the arm and its home pose.
    here = replace(joint, point=joint.point + 0.1 * BACK)
    extent = PlateExtent(low=-0.2, high=0.18, beyond=0.1)
    plate = moving_part(tip.position, -tip.axis, 1, here, extent)
    assert plate is not None
    checker = CollisionChecker(robot, Margins(scene=0.005))
    checker.set_boxes([plate])
    touched = []
    for known in (None, plate):
        planned = planner.retreat(standoff, np.random.default_rng(1), known)
        assert planned.trajectory is not None, planned.message
        path = planned.trajectory.positions
        touched.append(checker.free_count(path, contact_links=TOOL_LINKS) < len(path))
    assert touched == [True, False]


def test_near_a_hinge_the_opening_is_looked_at_in_small_turns() -> None:
    """The incident: two poses stood for an opening of 66 degrees, and the frame lay between."""
    contact, direction = np.array([0.5, 0.0, 0.3]), np.array([1.0, 0, 0])
    joint = JointEstimate(JointKind.REVOLUTE, np.array([0, 0, 1.0]), np.array([0.5, 0.03, 0.0]))
    travel = 0.03 * np.radians(66)
    poses = opening_poses(contact, direction, -1, 0.1, travel, joint, back_off=0.1)
    opening = poses.axes[poses.contact : poses.opened + 1]
    turns = [angle_between(a, b) for a, b in pairwise(opening)]
    assert 0 < max(turns) <= 0.25 + 1e-9
    assert angle_between(opening[0], opening[-1]) == pytest.approx(np.radians(66))
    # What comes after is the way back off, straight along the tool.
    back = np.diff(poses.positions[poses.opened :], axis=0)
    np.testing.assert_allclose(back @ opening[-1], -np.linalg.norm(back, axis=1), atol=1e-9)
