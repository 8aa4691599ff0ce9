"""The arm keeps out of what a seen surface may hide."""

import numpy as np

from franka_suction_driver.planning.hidden import hidden_points

EYE = np.array([0.0, -1.0, 0.5])
CELL = 0.015


def a_wall() -> np.ndarray:
    x, z = np.meshgrid(np.linspace(-0.1, 0.1, 40), np.linspace(0.4, 0.6, 40))
    return np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1).astype(np.float32)


def test_the_hidden_depth_of_a_frame_is_occupied():
    """The incident: the arm swung around a door and hit the back of a jamb, 8.5 cm deep."""
    solid = hidden_points(a_wall(), EYE, depth=0.07, cell=CELL)
    behind = np.array([0.0, 0.05, 0.5])
    assert np.linalg.norm(solid - behind, axis=1).min() < CELL
    assert 0.065 < solid[:, 1].max() < 0.072


def test_nothing_is_presumed_towards_the_camera():
    solid = hidden_points(a_wall(), EYE, depth=0.07, cell=CELL)
    assert solid[:, 1].min() > 0.0


def test_no_depth_and_no_points_hide_nothing():
    assert hidden_points(a_wall(), EYE, depth=0.0, cell=CELL).shape == (0, 3)
    assert hidden_points(np.empty((0, 3)), EYE, 0.07, CELL).shape == (0, 3)
