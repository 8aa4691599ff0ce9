"""Occluded volume behind surfaces, and a door that the arm hides from the camera."""

from __future__ import annotations

import numpy as np
import pytest

from flowbothd_common.motion import MotionGoal, MotionKind, MotionReason, MotionResult
from flowbothd_common.transforms import apply, transform
from flowbothd_common.types import JointEstimate, JointKind
from franka_suction_driver.planning.occlusion import OccludedPart, hidden_points

EYE = np.array([0.0, -1.0, 0.5])
CELL = 0.015


def a_wall() -> np.ndarray:
    x, z = np.meshgrid(np.linspace(-0.1, 0.1, 40), np.linspace(0.4, 0.6, 40))
    return np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1).astype(np.float32)


def test_the_hidden_depth_of_a_frame_is_occupied() -> None:
    """The incident: the arm swung around a door and hit the back of a jamb, 8.5 cm deep."""
    solid = hidden_points(a_wall(), EYE, depth=0.07, cell=CELL)
    behind = np.array([0.0, 0.05, 0.5])
    assert np.linalg.norm(solid - behind, axis=1).min() < CELL
    assert 0.065 < solid[:, 1].max() < 0.072


def test_nothing_is_presumed_towards_the_camera() -> None:
    solid = hidden_points(a_wall(), EYE, depth=0.07, cell=CELL)
    assert solid[:, 1].min() > 0.0


def test_no_depth_and_no_points_hide_nothing() -> None:
    assert hidden_points(a_wall(), EYE, depth=0.0, cell=CELL).shape == (0, 3)
    assert hidden_points(np.empty((0, 3)), EYE, 0.07, CELL).shape == (0, 3)


HINGE = JointEstimate(JointKind.REVOLUTE, np.array([0, 0, 1.0]), np.array([0.5, 0.2, 0.0]))
CONTACT, PULL = np.array([0.5, 0.0, 0.3]), np.array([-1.0, 0.0, 0.0])
APPROACH = MotionGoal(MotionKind.APPROACH, CONTACT, PULL, joint=HINGE)
LAST_PULL = np.array([-0.34, 0.94, 0.0])
STEP = MotionGoal(MotionKind.FLOW_STEP, None, LAST_PULL, 0.05, HINGE)


def cloud() -> np.ndarray:
    """A leaf from its hinge at y = 0.2 to y = -0.05, and a jamb at y = -0.2 that stands still."""
    y, z = np.meshgrid(np.arange(-0.05, 0.2, 0.01), np.arange(0.05, 0.5, 0.01))
    leaf = np.column_stack([np.full(y.size, 0.5), y.ravel(), z.ravel()])
    jamb = leaf[leaf[:, 1] > 0.1] - (0.0, 0.35, 0.0)
    return np.concatenate([leaf, jamb]).astype(np.float32)


def stepped(goal: MotionGoal = STEP) -> MotionResult:
    """The tool after it has opened the door by 90 degrees: along -y, at the leaf's new place."""
    rotation = np.column_stack([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    end = transform(rotation, (0.3, 0.2, 0.3))
    return MotionResult(goal.kind, MotionReason.REACHED, tool_end=end)


def test_before_it_moves_the_part_is_where_it_was_seen() -> None:
    held = OccludedPart()
    held.approached(APPROACH, cloud())
    assert held.plate is None
    none = np.empty((0, 3), dtype=np.float32)
    np.testing.assert_array_equal(held.completed(none), cloud())


def test_once_moved_it_is_a_plate_where_the_tool_held_it_and_what_stands_still_is_kept() -> None:
    """The incident: a departing arm pushed the leaf, and hit the frame, which both it hid."""
    held = OccludedPart()
    held.approached(APPROACH, cloud())
    held.stepped(STEP, stepped())
    plate = held.plate
    assert plate is not None
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    low, high = (
        f(apply(plate.pose, corners * np.array(plate.size) / 2), axis=0) for f in (np.min, np.max)
    )
    # From the hinge to as far as the leaf was seen to reach, as high as it was seen.
    assert high[0] == pytest.approx(0.5, abs=1e-6)
    assert low[0] == pytest.approx(0.25, abs=1e-3)
    assert (low[2], high[2]) == pytest.approx((0.05, 0.49), abs=1e-3)
    # The tool comes from +y: all of the plate lies on the other side of the lip.
    assert high[1] == pytest.approx(0.2, abs=1e-6)
    kept = held.completed(np.empty((0, 3), dtype=np.float32))
    assert kept is not None and len(kept)
    assert (kept[:, 1] < -0.1).all()


def test_a_slide_leaves_no_plate_and_no_camera_no_cloud() -> None:
    line = JointEstimate(JointKind.PRISMATIC, PULL, np.zeros(3))
    held = OccludedPart()
    held.approached(MotionGoal(MotionKind.APPROACH, CONTACT, PULL, joint=line), None)
    goal = MotionGoal(MotionKind.FLOW_STEP, None, PULL, 0.05, line)
    held.stepped(goal, stepped(goal))
    assert held.plate is None
    assert held.completed(None) is None


def test_another_approach_begins_anew() -> None:
    held = OccludedPart()
    held.approached(APPROACH, cloud())
    held.stepped(STEP, stepped())
    held.approached(APPROACH, cloud()[:7])
    assert held.plate is None
    assert len(held.completed(cloud()[:3])) == 10
