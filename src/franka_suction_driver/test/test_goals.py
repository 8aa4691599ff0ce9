"""Goals: what is refused, and which way tool and travel point."""

from __future__ import annotations

import numpy as np
import pytest

from flowbothd_common.errors import MotionRejectedError
from flowbothd_common.motion import MotionGoal, MotionKind
from flowbothd_common.transforms import angle_between, rotation_about
from franka_suction_driver.execution.goals import (
    checked_goal,
    lagging_axis,
    led_axes,
    led_axis,
    travel_direction,
)

X, Y = np.eye(3)[0], np.eye(3)[1]


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (MotionGoal(MotionKind.APPROACH, None, X), "approach needs a contact point"),
        (MotionGoal(MotionKind.APPROACH, np.array([0, np.nan, 0]), X), "3 finite numbers"),
        (MotionGoal(MotionKind.APPROACH, X, np.zeros(3)), "approach needs a direction"),
        (MotionGoal(MotionKind.PROBE), "probe needs a direction"),
        (MotionGoal(MotionKind.FLOW_STEP, None, X, distance=-0.1), "0 <= distance"),
        (MotionGoal(MotionKind.FLOW_STEP, None, X, distance=np.nan), "distance of flow_step"),
        (MotionGoal(MotionKind.PROBE, None, X, distance=2.0), "0 <= distance <= 0.5"),
    ],
)
def test_malformed_goals_say_what_is_missing(goal: MotionGoal, words: str) -> None:
    with pytest.raises(MotionRejectedError, match=words):
        checked_goal(goal)


def test_directions_become_unit_vectors() -> None:
    goal = checked_goal(MotionGoal(MotionKind.PROBE, None, np.array([0, 3.0, 0])))
    np.testing.assert_allclose(goal.direction, Y)
    assert checked_goal(MotionGoal(MotionKind.RETREAT)).direction is None


def test_probes_always_travel_where_the_tool_points() -> None:
    tilted = rotation_about(Y, 0.2) @ X
    np.testing.assert_allclose(travel_direction(X, tilted), tilted)
    np.testing.assert_allclose(travel_direction(X, -tilted), tilted)
    with pytest.raises(MotionRejectedError, match=r"90 degrees.*within 60"):
        travel_direction(X, Y)


def test_the_tool_keeps_its_side_and_turns_ahead_of_the_flow() -> None:
    for side in (1, -1):
        axis = -side * X
        flow = rotation_about(Y, 0.3) @ X
        led = led_axis(axis, flow, 0.5, 1.0)
        assert np.sign(led @ axis) == 1
        assert angle_between(axis, led) == pytest.approx(0.45)
        assert angle_between(led, -side * flow) == pytest.approx(0.15)
        assert angle_between(led_axis(axis, flow, 0.5, 0.1), -side * flow) == pytest.approx(0.1)
    np.testing.assert_allclose(led_axis(-X, X, 0.5, 0.2), -X)


def test_lesser_turns_follow_for_an_arm_that_cannot_turn_as_far() -> None:
    flow = rotation_about(Y, 0.4) @ X
    axes = led_axes(-X, flow, 0.5, 0.2)
    np.testing.assert_allclose([angle_between(-X, axis) for axis in axes], [0.6, 0.4, 0.2])
    assert len(led_axes(-X, X, 0.5, 0.2)) == 1


def test_a_pushing_tool_turns_only_when_it_would_tilt_too_far() -> None:
    """The incident: turning with the leaf, the pump's body swung into the frame at 20 degrees."""
    little, much = (rotation_about(Y, angle) @ X for angle in (0.3, 0.5))
    np.testing.assert_array_equal(lagging_axis(X, little, 0.4), X)
    turned = lagging_axis(X, much, 0.4)
    assert angle_between(turned, much) == pytest.approx(0.4)
    assert angle_between(turned, X) == pytest.approx(0.1)
