"""Joints, kinematics and flow, by finite differences."""

import numpy as np
import pytest

from flowbothd_common.errors import ObjectModelError
from flowbothd_model.data.articulated import (
    ArticulatedObject,
    JointKind,
    LinkJoint,
    flow_of,
    max_normalised,
)
from flowbothd_model.data.procedural.builder import Builder


def chain() -> ArticulatedObject:
    builder = Builder(np.random.default_rng(0))
    builder.box(builder.body, (0, 0, 0), (1, 1, 1))
    door = builder.hinge((0, 1, 0), (0, 0, -1), 1.5)
    builder.box(door, (-0.1, 0, 0), (0, 1, 1))
    knob = builder.hinge((-0.1, 0.2, 0.5), (1, 0, 0), 2.0, door)
    builder.rod(knob, (-0.1, 0.2, 0.5), (-0.2, 0.2, 0.5), 0.05)
    drawer = builder.slide((-1, 0.2, 0), 0.4, door)
    builder.box(drawer, (0, 0.5, 0.5), (0.1, 0.8, 0.8))
    return builder.finish("chain", "Safe", None)


def test_flow_is_the_derivative_of_the_motion_of_all_joints():
    item = chain()
    rng = np.random.default_rng(1)
    here = np.array([0.0, 0.7, 0.4, 0.1])
    step = 1e-6 * np.array([0.0, 1.0, 1.0, 1.0])
    local = rng.normal(size=(200, 3))
    links = rng.integers(0, 4, 200)

    def place(positions: np.ndarray) -> np.ndarray:
        poses = item.poses(positions)[links]
        return np.einsum("nij,nj->ni", poses[:, :3, :3], local) + poses[:, :3, 3]

    numeric = (place(here + step) - place(here - step)) / 2e-6
    analytic = flow_of(item.opening_twists(here), links, place(here).astype(np.float32))
    np.testing.assert_allclose(analytic, numeric, atol=1e-5)


def test_the_published_step_of_a_hundredth_gives_the_same_directions():
    item = chain()
    here = np.array([0.0, 0.3, 0.15, 0.1])
    before = item.posed_vertices(here)
    after = item.posed_vertices(here + 0.01 * np.array([0.0, 1.0, 1.0, 1.0]))
    published = max_normalised(after - before)
    ours = max_normalised(flow_of(item.opening_twists(here), item.vertex_link, before))
    assert np.abs(published - ours).max() < 0.01


def test_the_body_never_flows_and_children_follow_their_parents():
    item = chain()
    twists = item.opening_twists(item.closed())
    assert not twists[0].any()
    assert item.movable == [1, 2, 3]
    np.testing.assert_allclose(twists[3, :3], twists[1, :3])  # the slide turns with its door


def test_nothing_normalises_nothing():
    assert not max_normalised(np.zeros((5, 3), np.float32)).any()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"faces": np.zeros((0, 3), np.int64)}, "no faces"),
        ({"faces": np.array([[0, 1, 9]])}, "unknown vertices"),
        ({"vertex_link": np.array([0, 0, 5])}, "unknown links"),
        ({"joints": (LinkJoint(0, JointKind.FIXED),)}, "parent must come before"),
    ],
)
def test_a_broken_object_says_what_is_broken(change, words):
    parts = {
        "vertices": np.zeros((3, 3), np.float32),
        "faces": np.array([[0, 1, 2]]),
        "vertex_link": np.zeros(3, np.int64),
        "joints": (LinkJoint(),),
        **change,
    }
    with pytest.raises(ObjectModelError, match=words):
        ArticulatedObject("broken", "Box", **parts)
