"""Algebraic truths of the rigid transforms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flowbothd_common import transforms as tf

ANGLES = st.floats(-np.pi, np.pi)
DIRECTIONS = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3)


@given(ANGLES, ANGLES, ANGLES)
def test_quaternion_round_trip(roll, pitch, yaw):
    rotation = tf.rotation_from_rpy((roll, pitch, yaw))
    quaternion = tf.quaternion_from_rotation(rotation)
    assert quaternion[3] >= 0
    np.testing.assert_allclose(tf.rotation_from_quaternion(quaternion), rotation, atol=1e-12)


@given(DIRECTIONS, DIRECTIONS)
def test_rotation_between_maps_one_direction_to_the_other(a, b):
    rotation = tf.rotation_between(a, b)
    np.testing.assert_allclose(rotation @ tf.unit(a), tf.unit(b), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0)


def test_rotation_between_opposite_directions_is_a_half_turn():
    rotation = tf.rotation_between((0, 0, 1), (0, 0, -1))
    assert tf.rotation_angle(rotation) == pytest.approx(np.pi)


@given(DIRECTIONS, st.floats(0.0, np.pi))
def test_angle_of_a_rotation_about_an_axis(axis, angle):
    assert tf.rotation_angle(tf.rotation_about(axis, angle)) == pytest.approx(angle, abs=1e-7)


def test_inverse_and_apply():
    matrix = tf.transform(tf.rotation_from_rpy((0.3, -0.2, 2.0)), (1.0, 2.0, 3.0))
    points = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(tf.apply(tf.inverse(matrix), tf.apply(matrix, points)), points)
    assert tf.apply(matrix, points.astype(np.float32)).dtype == np.float32


def test_look_at_is_an_optical_frame():
    """REP-103: z into the scene, y down in the image."""
    matrix = tf.look_at((2.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    np.testing.assert_allclose(matrix[:3, 2], (-1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(matrix[:3, 1], (0, 0, -1), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(matrix[:3, :3]), 1.0)


def test_angle_between_is_accurate_for_nearly_parallel_directions():
    assert tf.angle_between((1, 0, 0), (1, 1e-9, 0)) == pytest.approx(1e-9, rel=1e-3)


@pytest.mark.parametrize("vector", [(0, 0, 0), (np.nan, 0, 0), (np.inf, 0, 0)])
def test_unit_refuses_what_has_no_direction(vector):
    with pytest.raises(ValueError, match="cannot normalise"):
        tf.unit(vector)
