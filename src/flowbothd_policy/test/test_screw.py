"""The fitted rigid motion: exact on clean fields, robust to noise and to other parts."""

import numpy as np
import pytest

from flowbothd_common.transforms import angle_between, unit
from flowbothd_common.types import JointKind
from flowbothd_policy.screw import fit_screw


def panel(rng, count=400, offset=(0.5, 0.0, 0.3)):
    uv = rng.uniform(-0.5, 0.5, (count, 2)) * (0.3, 0.5)
    return (np.column_stack([np.zeros(count), uv]) + offset).astype(np.float32)


@pytest.mark.parametrize("seed", range(5))
def test_finds_any_hinge(seed):
    rng = np.random.default_rng(seed)
    points = panel(rng)
    axis, at = unit(rng.normal(size=3)), np.array([0.5, 0.2, 0.3]) + rng.normal(scale=0.1, size=3)
    flow = np.cross(axis, points - at)
    largest = np.linalg.norm(flow, axis=1).max()
    flow = (flow / largest).astype(np.float32)
    screw = fit_screw(points, flow, points[0].astype(float))
    assert screw.joint.kind is JointKind.REVOLUTE
    assert angle_between(screw.joint.axis, axis) < 1e-3
    assert np.linalg.norm(np.cross(axis, screw.joint.point - at)) < 1e-3
    assert screw.rate == pytest.approx(1 / largest, rel=1e-3)
    np.testing.assert_allclose(screw.flow_at(points[3].astype(float)), flow[3], atol=1e-3)


def test_noise_is_averaged():
    rng = np.random.default_rng(0)
    points = panel(rng)
    flow = np.cross((0, 0, 1.0), points - (0.5, 0.15, 0)) / 0.3
    noisy = (flow + rng.normal(scale=0.1, size=flow.shape)).astype(np.float32)
    screw = fit_screw(points, noisy, np.array([0.5, -0.15, 0.3]))
    assert angle_between(screw.joint.axis, (0, 0, 1)) < np.radians(5)
    assert screw.radius_at(np.array([0.5, -0.15, 0.3])) == pytest.approx(0.3, rel=0.1)


def test_a_drawer_is_a_line_even_with_noise():
    rng = np.random.default_rng(1)
    points = panel(rng)
    flow = (np.array([-1, 0, 0]) + rng.normal(scale=0.1, size=points.shape)).astype(np.float32)
    screw = fit_screw(points, flow, points[0].astype(float))
    assert screw.joint.kind is JointKind.PRISMATIC
    assert angle_between(screw.joint.axis, (-1, 0, 0)) < np.radians(2)
    assert np.isinf(screw.radius_at(points[0].astype(float)))


def test_another_moving_door_is_left_out():
    rng = np.random.default_rng(2)
    left, right = panel(rng, offset=(0.5, 0.16, 0.3)), panel(rng, offset=(0.5, -0.16, 0.3))
    flow_left = np.cross((0, 0, -1.0), left - (0.5, 0.31, 0)) / 0.3
    flow_right = np.cross((0, 0, 1.0), right - (0.5, -0.31, 0)) / 0.3
    points = np.concatenate([left, right])
    flow = np.concatenate([flow_left, flow_right]).astype(np.float32)
    screw = fit_screw(points, flow, np.array([0.5, 0.02, 0.3]))
    assert angle_between(screw.joint.axis, (0, 0, -1)) < 0.02
    assert screw.joint.point[1] == pytest.approx(0.31, abs=0.01)


def test_nothing_that_moves_gives_nothing():
    points = panel(np.random.default_rng(3))
    assert fit_screw(points, np.zeros_like(points), points[0].astype(float)) is None
