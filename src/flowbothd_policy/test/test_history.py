"""Memory left by one step."""

from dataclasses import replace

import numpy as np
import pytest

from flowbothd_common.motion import MotionKind, MotionReason, MotionResult
from flowbothd_common.transforms import transform
from flowbothd_common.types import History
from flowbothd_policy.history import Memory, is_consistent, part_motion, remember
from flowbothd_policy.params import PolicyParams

PARAMS = PolicyParams()
ALONG_X = np.array([1.0, 0, 0])
SEEN = History(np.ones((3, 3), np.float32), np.zeros((3, 3), np.float32))


def result(reason, motion, vacuum=True):
    end = transform(translation=motion)
    return MotionResult(MotionKind.FLOW_STEP, reason, tool_end=end, vacuum=vacuum)


@pytest.mark.parametrize(
    ("reason", "length", "vacuum", "expected"),
    [
        (MotionReason.REACHED, 0.05, True, 0.05),
        (MotionReason.REACHED, 0.05, False, 0.0),
        (MotionReason.STALLED, 0.012, True, 0.0),
        (MotionReason.STALLED, 0.022, True, 0.0),
        (MotionReason.STALLED, 0.045, True, 0.03),
        (MotionReason.SUCTION_LOST, 0.013, False, 0.0),
        (MotionReason.UNREACHABLE, 0.05, True, 0.0),
    ],
)
def test_stretch_of_the_cup_is_no_motion(reason, length, vacuum, expected):
    """A wrong pull moved the tool 12 mm, above epsilon_m, by stretching the cup alone."""
    motion = part_motion(result(reason, (length, 0, 0), vacuum), PARAMS)
    assert np.linalg.norm(motion) == pytest.approx(expected)


def test_rigid_grippers_keep_every_motion():
    rigid = replace(PARAMS, compliance=0.0)
    motion = part_motion(result(MotionReason.STALLED, (0.002, 0, 0)), rigid)
    assert motion[0] == pytest.approx(0.002)


def test_accepted_motion_updates_both():
    memory = remember(Memory(), np.array([0.05, 0, 0]), ALONG_X, SEEN, PARAMS)
    assert memory.updated
    assert memory.history is SEEN
    np.testing.assert_array_equal(memory.direction, (0.05, 0, 0))


def test_a_prediction_that_the_motion_does_not_bear_out_is_not_remembered():
    """The incident: a drawer that was lifted slid out 1.5 cm, and "up" became its history."""
    across = remember(Memory(), np.array([0.015, 0, 0]), np.array([0, 0, 1.0]), SEEN, PARAMS)
    assert across.history is None and not across.updated
    np.testing.assert_array_equal(across.direction, (0.015, 0, 0))
    paper = replace(PARAMS, history_agreement=np.pi)
    assert remember(Memory(), np.array([0.015, 0, 0]), np.array([0, 0, 1.0]), SEEN, paper).updated
    # A pull straight out of a leaf that has turned by 45 degrees is as right as it can be.
    slanted = np.array([1.0, 1.0, 0]) / np.sqrt(2)
    assert remember(Memory(), np.array([0.05, 0, 0]), slanted, SEEN, PARAMS).updated


def test_small_motion_updates_the_direction_alone():
    memory = remember(Memory(), np.array([0.009, 0, 0]), ALONG_X, SEEN, PARAMS)
    assert not memory.updated
    assert memory.history is None
    assert memory.direction is not None


def test_no_motion_and_backward_motion_change_nothing():
    before = Memory(np.array([0.05, 0, 0]), (), SEEN)
    other = History(np.zeros((2, 3), np.float32), np.zeros((2, 3), np.float32))
    for motion in (np.zeros(3), np.array([-0.05, 0, 0])):
        after = remember(before, motion, motion, other, PARAMS)
        assert after.history is SEEN
        np.testing.assert_array_equal(after.direction, before.direction)
        assert not after.updated


def test_filter_off_remembers_every_step():
    off = replace(PARAMS, history_filter=False)
    after = remember(Memory(np.array([0.05, 0, 0])), np.zeros(3), ALONG_X, SEEN, off)
    assert after.updated
    assert after.history is SEEN
    np.testing.assert_array_equal(after.direction, (0.05, 0, 0))


def test_consistency_is_thirty_degrees():
    memory = Memory(np.array([0.05, 0, 0]))
    near, far = (np.array([np.cos(a), np.sin(a), 0]) for a in np.radians([29, 31]))
    assert is_consistent(near, memory, PARAMS)[0]
    assert not is_consistent(far, memory, PARAMS)[0]
    assert is_consistent(far, memory, replace(PARAMS, consistency_check=False))[0]
    assert is_consistent(far, Memory(), PARAMS)[0]


def test_jitter_may_be_kept_from_the_direction():
    """With compliance 0 a failed step's 1 mm would bind all later samples to its direction."""
    careful = replace(PARAMS, consistency_min_motion=0.005)
    assert remember(Memory(), np.array([0.001, 0, 0]), ALONG_X, SEEN, careful).direction is None
    assert remember(Memory(), np.array([0.001, 0, 0]), ALONG_X, SEEN, PARAMS).direction is not None


def test_a_part_that_fell_back_may_move_as_it_did_before():
    """The incident: a lid shut itself when released, and all 50 samples were 37 degrees off."""
    memory = remember(Memory(), np.array([0, 0, 0.05]), np.array([0, 0, 1.0]), SEEN, PARAMS)
    turned = np.array([np.sin(0.7), 0, np.cos(0.7)])
    memory = remember(memory, 0.05 * turned, turned, SEEN, PARAMS)
    shut = np.array([0, 0, 1.0])
    assert not is_consistent(shut, memory, PARAMS, attached=True)[0]
    assert is_consistent(shut, memory, PARAMS, attached=False)[0]
    assert not is_consistent(-shut, memory, PARAMS, attached=False)[0]
    paper = replace(PARAMS, recontact_consistency="last")
    assert not is_consistent(shut, memory, paper, attached=False)[0]
