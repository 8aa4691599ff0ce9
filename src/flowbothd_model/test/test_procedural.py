"""Objects made by rule: all categories, reproducible, and the door whose mode cannot be seen."""

import numpy as np
import pytest

from flowbothd_model.data.articulated import flow_of
from flowbothd_model.data.procedural.catalogue import MAKERS, make
from flowbothd_model.data.procedural.panels import DoorMode, four_mode_door
from flowbothd_model.data.sampling import SampleConfig, Situation, draw_sample


def test_there_are_the_21_categories_of_the_paper():
    assert len(MAKERS) == 21


@pytest.mark.parametrize("category", sorted(MAKERS))
def test_every_category_moves_and_differs_from_number_to_number(category):
    shapes = set()
    for number in range(6):
        item = make(category, number)
        assert item.movable
        assert np.isfinite(item.vertices).all()
        np.testing.assert_allclose(np.linalg.norm(np.ptp(item.vertices, axis=0)), 2.0, rtol=1e-4)
        for joint in item.joints:
            np.testing.assert_allclose(np.linalg.norm(joint.axis), 1.0, atol=1e-9)
        shapes.add(item.vertices.tobytes())
    assert len(shapes) == 6


@pytest.mark.parametrize("category", sorted(MAKERS))
def test_the_same_number_gives_the_same_object_and_can_be_seen_in_every_situation(category):
    item, again = make(category, 3), make(category, 3)
    np.testing.assert_array_equal(item.vertices, again.vertices)
    assert item.joints == again.joints
    for situation in Situation:
        shown = SampleConfig(points=256)
        rngs = [np.random.default_rng(5) for _ in range(2)]
        one, two = (
            draw_sample(i, situation, shown, r) for i, r in zip((item, again), rngs, strict=True)
        )
        assert one is not None
        assert two is not None
        np.testing.assert_array_equal(one.current.points, two.current.points)
        assert np.linalg.norm(one.current.flow, axis=1).max() == pytest.approx(1.0, abs=1e-4)
        assert (one.history is not None) == (situation is Situation.HISTORY)


def test_an_unknown_category_lists_the_known_ones():
    with pytest.raises(KeyError, match="Door"):
        make("Spoon", 0)


def test_the_four_modes_look_alike_closed_and_open_differently():
    doors = {mode: four_mode_door(np.random.default_rng(0), mode) for mode in DoorMode}
    first = doors[DoorMode.PULL_LEFT]
    flows = {}
    for mode, door in doors.items():
        np.testing.assert_array_equal(door.vertices, first.vertices)
        twists = door.opening_twists(door.closed())
        flows[mode] = flow_of(twists, door.vertex_link, door.vertices).mean(0)
        leaf = door.vertices[door.vertex_link == 1]
        np.testing.assert_allclose(np.ptp(leaf, axis=0), (0.0175, 0.1683, 0.434), atol=2e-3)
    for side in ("LEFT", "RIGHT"):
        assert flows[DoorMode[f"PULL_{side}"]][0] < 0 < flows[DoorMode[f"PUSH_{side}"]][0]
    # Hinged at the left (+y), the free edge is at the right and moves there most.
    pull_left = doors[DoorMode.PULL_LEFT]
    flow = flow_of(
        pull_left.opening_twists(pull_left.closed()), pull_left.vertex_link, pull_left.vertices
    )
    free = pull_left.vertices[np.linalg.norm(flow, axis=1).argmax()]
    assert free[1] < 0


def test_ambiguous_doors_are_common_and_their_modes_equally_likely():
    modes = []
    for number in range(400):
        item = make("Door", number)
        if len(item.joints) != 2 or len(item.faces) > 12 * 5:
            continue
        joint = item.joints[1]
        if joint.kind != "revolute":
            continue
        left = joint.point[1] > 0
        modes.append((left, (joint.axis[2] < 0) == left))
    counts = np.unique(np.array(modes) @ np.array([2, 1]), return_counts=True)[1]
    assert len(modes) > 120
    assert counts.min() > 0.15 * len(modes)
