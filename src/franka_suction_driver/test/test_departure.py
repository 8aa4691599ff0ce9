"""Departure from a contact: what touches may go on for a while, nothing else may begin to."""

from __future__ import annotations

import numpy as np
import pytest

from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.params import MotionParams
from franka_suction_driver.planning.collision import CollisionChecker, Margins
from franka_suction_driver.planning.departure import escape, leaves_and_stays_free
from franka_suction_driver.planning.inverse_kinematics import follow

START = np.array(MotionParams().robot.start_positions)


@pytest.fixture
def back(robot: Kinematics, limits: JointLimits) -> Array:
    """(11, J) from the start pose 10 cm straight back along the tool."""
    tip = robot.tip(START)
    positions = tip.position - np.outer(np.linspace(0, 0.1, 11), tip.axis)
    path = follow(robot, limits.box(0.05), START[None], positions, np.tile(tip.axis, (11, 1)))
    return path.positions[0]


def checker_with(robot: Kinematics, points: Array) -> CollisionChecker:
    checker = CollisionChecker(robot, Margins(scene=0.01))
    checker.set_points(points)
    return checker


def around(point: Array, size: float) -> Array:
    return point + np.random.default_rng(0).uniform(-size, size, (60, 3))


def test_backing_off_a_touched_surface_ends_free(robot: Kinematics, back: Array) -> None:
    checker = checker_with(robot, around(robot.tip(START).position, 0.004))
    assert not checker.free(back[0])
    way, rest = escape(checker, back, [])
    assert rest is not None
    np.testing.assert_array_equal(rest, back[-1])
    assert checker.free(rest)
    assert leaves_and_stays_free(checker, way)


def test_a_new_touch_cuts_the_way_short(robot: Kinematics, back: Array) -> None:
    """The tool backs off the surface, but something stands in the way of the arm behind it."""
    tip = robot.tip(START).position
    near = around(tip, 0.004)
    rng = np.random.default_rng(3)
    for _ in range(2000):
        spot = around(tip + rng.uniform([-0.3, -0.3, 0.1], [0.1, 0.3, 0.5]), 0.01)
        alone = checker_with(robot, spot)
        if alone.free(back[0]) and alone.free(back[3]) and not alone.free(back[7]):
            break
    else:
        pytest.fail("no spot is swept by the way back alone")
    checker = checker_with(robot, np.concatenate([near, spot]))
    way, rest = escape(checker, back, [])
    assert len(way) < len(back)
    assert rest is not None
    assert checker.free(rest)
    assert not leaves_and_stays_free(checker, back)


def test_where_backing_off_is_not_enough_the_arm_goes_on(robot: Kinematics, back: Array) -> None:
    checker = checker_with(robot, around(robot.tip(START).position, 0.004))
    aside = START.copy()
    aside[0] += 0.8
    way, rest = escape(checker, back[:1], [aside])
    assert rest is not None
    assert checker.free(rest)
    assert len(way) == 2


def test_no_way_out_is_told(robot: Kinematics, back: Array) -> None:
    checker = checker_with(robot, around(robot.tip(START).position, 0.004))
    way, rest = escape(checker, back[:1], [])
    assert rest is None
    assert len(way) == 1
