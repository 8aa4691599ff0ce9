"""Grasp points and directions chosen from flow fields."""

from dataclasses import replace

import numpy as np
import pytest

from flowbothd_common.transforms import angle_between, rotation_about
from flowbothd_policy.grasp_selection import Place, select_grasp
from flowbothd_policy.params import GraspParams
from sim_bridge.oracle import OracleParams, draw

PAPER = GraspParams(edge_margin=0.0, direction="flow", normal_angle=0.0, table_clearance=0.0)


@pytest.fixture
def scene(make_door):
    door = make_door("pull_left", seed=4)
    points = door.observe()
    return door, points, draw(door.truth(points), OracleParams(), 1, 7)[0]


def test_without_margin_it_is_the_arg_max(scene):
    _, points, flow = scene
    grasp = select_grasp(points, flow, PAPER, leverage=0.2)
    top = int(np.argmax(np.linalg.norm(flow, axis=1)))
    assert grasp.index == top
    np.testing.assert_array_equal(grasp.flow, flow[top].astype(float))


@pytest.mark.parametrize("seed", range(20))
def test_with_margin_the_cup_fits_on_the_leaf(make_door, seed):
    door = make_door("pull_left", seed=seed)
    points = door.observe()
    flow = draw(door.truth(points), OracleParams(), 1, seed)[0]
    grasp = select_grasp(points, flow, GraspParams(), leverage=0.2)
    inset = min(door.width / 2 - abs(grasp.point[1]), grasp.point[2] - 0.02, 0.455 - grasp.point[2])
    assert inset > 0.015
    radius = door.width / 2 - grasp.point[1]
    assert radius > 0.78 * door.width
    assert angle_between(grasp.flow, (-1, 0, 0)) < np.radians(12)


def test_the_thin_edge_face_is_not_grasped():
    """The face seen edge-on moves fastest, but along itself: no cup can pull it that way."""
    rng = np.random.default_rng(0)
    front = np.column_stack(
        [np.full(500, 0.5), rng.uniform(-0.1, 0.1, 500), rng.uniform(0, 0.4, 500)]
    )
    edge = np.column_stack(
        [0.5 + rng.uniform(0, 0.06, 300), np.full(300, -0.1), rng.uniform(0, 0.4, 300)]
    )
    points = np.concatenate([front, edge]).astype(np.float32)
    flow = np.cross((0, 0, 1.0), points - (0.5, 0.1, 0)).astype(np.float32)
    flow /= np.linalg.norm(flow, axis=1).max()
    grasp = select_grasp(points, flow, GraspParams(), leverage=0.2)
    assert grasp.point[1] > -0.095
    assert grasp.point[0] == pytest.approx(0.5)


def test_sparse_clouds_still_give_a_grasp():
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (60, 3)).astype(np.float32)
    points[:, 0] = 0
    flow = np.tile(np.float32([1, 0, 0]), (60, 1))
    grasp = select_grasp(points, flow, GraspParams(), leverage=0.2)
    assert np.abs(grasp.point[1:]).max() < 0.9


def test_avoided_places_are_kept_off(scene):
    _, points, flow = scene
    first = select_grasp(points, flow, GraspParams(), leverage=0.2)
    avoid = Place(first.point, first.direction, 0.05)
    second = select_grasp(
        points, flow, GraspParams(), leverage=0.2, avoid=(avoid,), avoid_angle=np.radians(30)
    )
    assert np.linalg.norm(second.point - first.point) >= 0.05
    opposite = replace(avoid, direction=-avoid.direction)
    same = select_grasp(
        points, flow, GraspParams(), leverage=0.2, avoid=(opposite,), avoid_angle=np.radians(30)
    )
    assert same.index == first.index


def test_everything_avoided_or_still_gives_none(scene):
    _, points, flow = scene
    everywhere = Place(points.mean(axis=0), np.array([-1.0, 0, 0]), 10.0)
    avoided = select_grasp(
        points, flow, PAPER, leverage=0.2, avoid=(everywhere,), avoid_angle=np.pi / 2
    )
    assert avoided is None
    assert select_grasp(points, np.zeros_like(flow), PAPER, leverage=0.2) is None


def test_less_leverage_is_better_than_no_seal():
    """The incident: six contacts on the thin top face of a door, all without vacuum."""
    rng = np.random.default_rng(0)
    front = np.column_stack(
        [np.full(500, 0.5), rng.uniform(-0.05, 0.1, 500), rng.uniform(0, 0.4, 500)]
    )
    rim = np.column_stack(
        [0.5 + rng.uniform(0, 0.02, 200), rng.uniform(-0.1, 0.1, 200), np.full(200, 0.4)]
    )
    points = np.concatenate([front, rim]).astype(np.float32)
    flow = np.cross((0, 0, 1.0), points - (0.5, 0.1, 0)).astype(np.float32)
    flow /= np.linalg.norm(flow, axis=1).max()
    wide = select_grasp(points, flow, GraspParams(), leverage=0.2)
    assert wide.edge_distance >= 0.018
    assert 0.5 <= wide.norm < 0.8


def leaf_with_flow_off_by(angle):
    """A leaf in the y-z plane, hinged at y = 0, whose predicted field is turned about z."""
    rng = np.random.default_rng(5)
    y, z = rng.uniform(0.0, 0.17, 900), rng.uniform(0.0, 0.43, 900)
    points = np.column_stack([rng.normal(0, 5e-4, 900), y, z]).astype(np.float32)
    flow = np.column_stack([y / 0.17, np.zeros_like(y), np.zeros_like(y)])
    return points, (flow @ rotation_about(np.array([0.0, 0.0, 1.0]), angle).T).astype(np.float32)


@pytest.mark.parametrize("degrees", [-30.0, -20.0, 25.0])
def test_pull_and_motion_turn_onto_the_normal_of_a_flat_part(degrees):
    points, flow = leaf_with_flow_off_by(np.radians(degrees))
    grasp = select_grasp(points, flow, GraspParams(), leverage=0.2)
    assert angle_between(grasp.direction, np.array([1.0, 0.0, 0.0])) < np.radians(2)
    assert grasp.screw is not None
    there = grasp.screw.flow_at(grasp.point)
    assert angle_between(there, grasp.direction) < np.radians(2)
    assert np.linalg.norm(there) == pytest.approx(np.linalg.norm(grasp.flow), rel=1e-6)


def test_a_pull_far_from_the_normal_stays_as_predicted():
    points, flow = leaf_with_flow_off_by(np.radians(50))
    grasp = select_grasp(points, flow, GraspParams(direction="flow"), leverage=0.2)
    assert angle_between(grasp.direction, np.array([1.0, 0.0, 0.0])) == pytest.approx(
        np.radians(50), abs=np.radians(3)
    )


def leaf(low: float, high: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points of an upright leaf between two heights, hinged at y = 0.1, and their flow."""
    rng = np.random.default_rng(seed)
    points = np.column_stack(
        [np.full(900, 0.5), rng.uniform(-0.1, 0.1, 900), rng.uniform(low, high, 900)]
    ).astype(np.float32)
    flow = np.cross((0, 0, 1.0), points - (0.5, 0.1, 0)).astype(np.float32)
    return points, flow / np.linalg.norm(flow, axis=1).max()


@pytest.mark.parametrize("seed", range(10))
def test_an_upright_leaf_is_held_where_the_wrist_has_room(seed):
    points, flow = leaf(0.0, 0.4, seed)
    flow[points[:, 2] < 0.1] *= 1.02  # the noise of a prediction speaks for the lower end
    assert select_grasp(points, flow, PAPER, leverage=0.2).point[2] < 0.1
    for params in (PAPER, GraspParams()):
        clear = replace(params, table_clearance=0.12)
        assert select_grasp(points, flow, clear, leverage=0.2).point[2] >= 0.12


def test_a_low_drawer_is_held_all_the_same():
    points, _ = leaf(0.02, 0.1)
    flow = np.tile(np.float32([-1, 0, 0]), (len(points), 1))
    grasp = select_grasp(points, flow, GraspParams(table_clearance=0.12), leverage=0.2)
    assert grasp.point[2] < 0.1


def test_a_low_lid_is_held_wherever_its_leverage_is_largest():
    rng = np.random.default_rng(0)
    points = np.column_stack(
        [rng.uniform(0.4, 0.6, 900), rng.uniform(-0.1, 0.1, 900), np.full(900, 0.05)]
    )
    high = np.column_stack(
        [rng.uniform(0.6, 0.605, 60), rng.uniform(-0.1, 0.1, 60), rng.uniform(0.12, 0.2, 60)]
    )
    points = np.concatenate([points, high]).astype(np.float32)
    flow = np.cross((0, -1.0, 0), points - (0.62, 0, 0.05)).astype(np.float32)
    flow[900:] = 0
    flow /= np.linalg.norm(flow, axis=1).max()
    grasp = select_grasp(points, flow, GraspParams(table_clearance=0.12), leverage=0.2)
    assert grasp.point[0] < 0.45
