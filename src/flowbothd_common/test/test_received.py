"""The entrance for messages: what is good passes unchanged, what is not is refused by name."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

NAMES = ("a", "b")


def joints(**changes: Any) -> Any:
    from sensor_msgs.msg import JointState

    return JointState(**{"name": ["b", "a"], "position": [2.0, 1.0], **changes})


def trajectory(**changes: Any) -> Any:
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    values = {
        "positions": [2.0, 1.0],
        "velocities": [0.0, 0.0],
        "accelerations": [0.0, 0.0],
        "time_from_start": Duration(nanosec=10**8),
        **changes,
    }
    return JointTrajectory(joint_names=["b", "a"], points=[JointTrajectoryPoint(**values)])


def test_joint_states_are_read_by_name_and_need_no_velocities():
    from flowbothd_common.ros.received import joint_state

    positions, velocities = joint_state(joints(), NAMES)
    np.testing.assert_array_equal(positions, [1.0, 2.0])
    np.testing.assert_array_equal(velocities, [0.0, 0.0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"position": []}, "joint positions are incomplete; got 0; allowed: 2"),
        ({"position": [1.0]}, "incomplete"),
        ({"position": [1.0, math.nan]}, "joint positions are not finite; got nan at index 1"),
        ({"velocity": [0.0, math.inf]}, "joint velocities are not finite"),
        ({"velocity": [0.0]}, "joint velocities are incomplete"),
        ({"name": ["b", "c"]}, "joints missing: ['a']"),
        ({"name": []}, "joints missing: ['a', 'b']"),
        ({"position": [9.0, 1.0]}, "b is far outside its range; got 9 rad; allowed: -3 .. 3 rad"),
        ({"velocity": [0.0, -50.0]}, "a is faster than it can be; got -50 rad/s"),
    ],
)
def test_joint_states_that_cannot_be_used_are_refused_by_name(changes, words):
    """The incident: names without positions, legal in ROS, ended the nodes that move the arm."""
    from flowbothd_common.errors import InvalidMessageError
    from flowbothd_common.ros.received import joint_state

    limits = (np.full(2, -3.0), np.full(2, 3.0), np.full(2, 2.0))
    with pytest.raises(InvalidMessageError) as error:
        joint_state(joints(**changes), NAMES, limits)
    assert words in str(error.value)


def test_joint_states_of_a_gripper_alone_are_passed_over():
    """The incident: a gripper's two joints on the arm's topic made diagnostics flicker."""
    from flowbothd_common.errors import InvalidMessageError
    from flowbothd_common.ros.received import joint_state

    other = joints(name=["finger_1", "finger_2"])
    assert joint_state(other, NAMES) is None
    with pytest.raises(InvalidMessageError, match="joints missing"):
        joint_state(other, NAMES, expected=True)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("x", math.nan, "not finite"),
        ("y", -math.inf, "not finite"),
        ("z", 1e300, "largest force or torque"),
    ],
)
def test_a_wrench_is_finite_and_in_its_frame(field, value, words):
    from geometry_msgs.msg import WrenchStamped

    from flowbothd_common.errors import InvalidMessageError
    from flowbothd_common.ros.received import wrench

    message = WrenchStamped()
    message.header.frame_id = "base"
    message.wrench.torque.z = 2.0
    np.testing.assert_array_equal(wrench(message, "base"), [0, 0, 0, 0, 0, 2.0])
    with pytest.raises(InvalidMessageError, match="another frame; got 'base'; allowed: flange"):
        wrench(message, "flange")
    setattr(message.wrench.force, field, value)
    with pytest.raises(InvalidMessageError, match=words):
        wrench(message, "base")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"accelerations": []}, "accelerations of point 0 are incomplete; got 0; allowed: 2"),
        ({"positions": [1.0, math.nan]}, "positions of point 0 are not finite"),
        ({"velocities": [0.0]}, "velocities of point 0 are incomplete"),
    ],
)
def test_trajectories_say_what_is_missing(changes, words):
    """The incident: a trajectory without points or accelerations: "index 0 is out of bounds"."""
    from flowbothd_common.errors import InvalidMessageError
    from flowbothd_common.ros import received

    good = received.trajectory(trajectory(), NAMES)
    np.testing.assert_array_equal(good.positions, [[1.0, 2.0]])
    with pytest.raises(InvalidMessageError) as error:
        received.trajectory(trajectory(**changes), NAMES)
    assert words in str(error.value)


def test_trajectories_without_points_or_of_other_joints_are_refused():
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectory

    from flowbothd_common.errors import InvalidMessageError
    from flowbothd_common.ros import received

    with pytest.raises(InvalidMessageError, match="has no points"):
        received.trajectory(JointTrajectory(joint_names=["a", "b"]), NAMES)
    with pytest.raises(InvalidMessageError, match="other joints; got none; allowed: a, b"):
        received.trajectory(JointTrajectory(), NAMES)
    with pytest.raises(InvalidMessageError, match="do not increase from above 0"):
        received.trajectory(trajectory(time_from_start=Duration()), NAMES)


def test_stamps_are_near_the_clock_and_in_order():
    from flowbothd_common.errors import InvalidMessageError
    from flowbothd_common.ros.conversions import to_stamp
    from flowbothd_common.ros.received import StampCheck

    check = StampCheck(0.5)
    check.check("topic", to_stamp(100.0), 100.1)
    check.check("topic", to_stamp(0.0), 100.1)
    check.check("topic", to_stamp(100.0), 100.1)
    for stamp, words in ((3.0, "97.1 s in the past"), (3700.0, "3599.9 s in the future")):
        with pytest.raises(InvalidMessageError, match=words):
            check.check("topic", to_stamp(stamp), 100.1)
    with pytest.raises(InvalidMessageError, match="before the last one"):
        check.check("topic", to_stamp(99.9), 100.1)
    # After a jump of the clock itself the order begins again.
    check.check("topic", to_stamp(50.0), 50.1)


def test_every_malformed_motion_result_is_read_or_refused():
    from flowbothd_common.errors import InvalidMessageError
    from flowbothd_common.ros.malformed import malformations
    from flowbothd_common.ros.received import motion_result
    from flowbothd_interfaces.msg import MotionResult

    good = MotionResult(motion="probe", reason="vacuum")
    assert motion_result(good).reason == "vacuum"
    refused = 0
    for label, bad in malformations(good):
        try:
            assert np.isfinite(motion_result(bad).tool_end).all(), label
        except InvalidMessageError:
            refused += 1
    assert refused > 30


def test_malformations_differ_from_the_good_message_in_one_thing():
    from std_msgs.msg import Header

    from flowbothd_common.ros.malformed import malformations

    good = joints(velocity=[0.0, 0.1], header=Header(frame_id="base"))
    good.header.stamp.sec = 5000
    before = copy.deepcopy(good)
    found = dict(malformations(good))
    assert good == before
    assert len(found) > 20
    assert all(bad != good for label, bad in found.items() if "nan" not in label)
    assert len(found["position short"].position) == 1


def test_a_source_whose_messages_are_refused_is_silent_at_the_second():
    from flowbothd_common.ros.liveness import Silence

    silence = Silence(1.0)
    silence.heard("wrench", 0.0)
    silence.refused("wrench", "not finite")
    assert silence.silent(["wrench"], 0.01) == []
    silence.refused("wrench", "not finite")
    assert silence.silent(["wrench"], 0.02) == ["wrench"]
    assert silence.why("wrench", 0.02) == "no wrench for 0.0 s: 2 refused, not finite"
    silence.heard("wrench", 0.03)
    assert silence.silent(["wrench"], 0.04) == []
