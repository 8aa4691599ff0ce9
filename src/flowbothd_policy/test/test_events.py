"""The policy processes what its log contains: every event survives conversion to a message."""

from __future__ import annotations

import numpy as np
import pytest

from flowbothd_common.motion import MotionKind, MotionReason, MotionResult
from flowbothd_common.transforms import rotation_from_quaternion
from flowbothd_common.types import SuctionPhase
from flowbothd_policy.events import (
    NAMES,
    CloudArrived,
    InputsBack,
    InputsLost,
    MotionFinished,
    OperatorStop,
    PredictionArrived,
    PredictionFailed,
    Start,
    SuctionChanged,
    WaitExpired,
)

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="ROS is not installed")

POINTS = np.arange(12, dtype=np.float32).reshape(4, 3)
EVENTS = (
    Start(),
    CloudArrived(POINTS, 12.25),
    PredictionArrived(POINTS, POINTS[None], 12.25, "oracle", seed=2**64 - 1),
    PredictionFailed("no weights"),
    SuctionChanged(SuctionPhase.LOST, "the part came off"),
    InputsLost(("bridge_node (silent)", "predict_flow")),
    InputsBack(),
    WaitExpired(),
    OperatorStop("enough", opened=True),
    OperatorStop("enough", opened=False),
    OperatorStop("enough"),
)


class Sights:
    """Clouds and predictions by stamp and seed, as a bag keeps them."""

    def __init__(self):
        self.asked = []

    def cloud(self, stamp):
        self.asked.append((stamp.sec, stamp.nanosec))
        return POINTS

    def prediction(self, stamp, seed):
        self.asked.append((stamp.sec, stamp.nanosec, seed))
        return POINTS, POINTS[None]


def through_message(event, sights=None):
    from rclpy.serialization import deserialize_message, serialize_message
    from std_msgs.msg import Header

    from flowbothd_interfaces.msg import PolicyEvent
    from flowbothd_policy.events_ros import from_event_message, to_event_message

    message = to_event_message(event, Header(frame_id="base"), 7)
    read = deserialize_message(serialize_message(message), PolicyEvent)
    assert read.sequence == 7
    return from_event_message(read, sights or Sights())


@pytest.mark.parametrize("event", EVENTS, ids=lambda e: NAMES[type(e)])
def test_every_event_comes_back_as_it_was(event):
    assert str(through_message(event)) == str(event)


def test_all_kinds_of_events_are_tried():
    assert {type(event) for event in EVENTS} | {MotionFinished} == set(NAMES)


def test_arrays_are_asked_for_by_exact_stamp_and_seed():
    sights = Sights()
    through_message(CloudArrived(POINTS, 12.123456789), sights)
    through_message(PredictionArrived(POINTS, POINTS[None], 0.1, "", 9), sights)
    assert sights.asked == [(12, 123456789), (0, 100000000, 9)]


def test_a_motion_result_is_what_its_message_says():
    """The node hands the policy the event that it has published, not its own.

    A rotation changes in the last bits on its way through a quaternion.
    """
    rng = np.random.default_rng(0)
    quaternion = rng.normal(size=4)
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_quaternion(quaternion / np.linalg.norm(quaternion))
    pose[:3, 3] = rng.normal(size=3)
    result = MotionResult(
        MotionKind.FLOW_STEP,
        MotionReason.STALLED,
        "it sticks",
        reached_fraction=0.3,
        tool_end=pose,
        peak_wrench=rng.normal(size=6),
        max_lag=0.1,
        duration=2.5,
    )
    once = through_message(MotionFinished(result)).result
    np.testing.assert_allclose(once.tool_end, pose, atol=1e-12)
    np.testing.assert_array_equal(once.tool_end[:3, 3], pose[:3, 3])
    assert (once.kind, once.reason, once.message) == (result.kind, result.reason, result.message)
    np.testing.assert_array_equal(once.peak_wrench, result.peak_wrench)


def test_a_state_of_the_pump_that_nobody_knows_is_a_fault():
    from flowbothd_policy.events_ros import phase_of

    assert phase_of(250) is SuctionPhase.FAULT
