"""True flow against finite differences of the kinematics, and its conventions."""

import numpy as np
import pytest

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.transforms import apply, rotation_from_rpy, transform
from sim_bridge.ground_truth import STEP, FlowOracle
from sim_bridge.objects import load_object
from sim_bridge.objects.custom_door import MODES

POSE = transform(rotation_from_rpy((0.0, 0.0, 0.7)), (0.5, -0.1, 0.2))


def surface(model, link, positions, rng, count=50):
    """Random surface points of a link in base."""
    mesh = model.links[link].mesh
    corners = mesh.vertices[mesh.faces[rng.integers(len(mesh.faces), size=count)]]
    weights = rng.dirichlet((1, 1, 1), size=count)
    points = np.einsum("nk,nkd->nd", weights, corners)
    return apply(POSE @ model.displacement(link, positions), points)


def at(model, ratio):
    return {j.name: j.lower + ratio * (j.upper - j.lower) for j in model.joints.values()}


def moved_by_all(model, link, points, positions):
    """Sum of the displacements when the joints advance one after another, each from the start."""
    total = np.zeros_like(points)
    before = POSE @ model.displacement(link, positions)
    local = apply(np.linalg.inv(before), points)
    for name in model.joints:
        advanced = {**positions, name: positions[name] + STEP}
        total += apply(POSE @ model.displacement(link, advanced), local) - points
    return total


@pytest.mark.parametrize("name", ["custom_door", "drawer", "cabinet_door", "lidded_box"])
@pytest.mark.parametrize("ratio", [0.0, 0.4, 1.0])
def test_flow_is_what_a_little_opening_does(name, ratio, rng):
    model = load_object(name)
    positions = at(model, ratio)
    moving = model.target.child
    others = [link for link in model.links if link != moving]
    points = np.concatenate([surface(model, link, positions, rng) for link in (moving, *others)])
    truth = FlowOracle(model).flow(points, POSE, positions)
    wanted = np.concatenate(
        [moved_by_all(model, moving, points[:50], positions), np.zeros_like(points[50:])]
    )
    wanted /= np.linalg.norm(wanted, axis=1).max()
    # Neighbouring links touch within a hair: a few points may be taken for the other one.
    wrong = np.linalg.norm(truth.flows[0] - wanted, axis=1) > 1e-3
    assert wrong.mean() < 0.05
    assert np.linalg.norm(truth.flows[0], axis=1).max() == pytest.approx(1.0, abs=1e-6)
    assert truth.flows.dtype == np.float32
    assert truth.open_ratio == pytest.approx(ratio)


def test_descendants_and_every_joint_move(raw_object, rng):
    """All four doors and drawers of the cabinet have flow; the knob of the door moves with it."""
    cabinet, door = raw_object(41083), raw_object(8994)
    positions = at(cabinet, 0.3)
    oracle = FlowOracle(cabinet)
    for joint in cabinet.joints.values():
        points = surface(cabinet, joint.child, positions, rng, 200)
        truth = oracle.flow(points, POSE, positions)
        wanted = moved_by_all(cabinet, joint.child, points, positions)
        wanted /= np.linalg.norm(wanted, axis=1).max()
        assert np.median(np.linalg.norm(truth.flows[0] - wanted, axis=1)) < 1e-3
        if joint.name != cabinet.target_joint:
            assert not oracle.flow(points, POSE, positions, target_only=True).flows.any()
    knob = surface(door, "link_1", at(door, 0.2), rng)
    assert FlowOracle(door).flow(knob, POSE, at(door, 0.2)).flows[0].any(axis=1).mean() > 0.9


@pytest.mark.parametrize("mode", MODES)
def test_the_other_modes_rows_are_the_other_doors_truth(mode, rng):
    model = load_object("custom_door", mode=mode)
    closed = model.closed()
    points = surface(model, "leaf", closed, rng, 300)
    truth = FlowOracle(model).flow(points, POSE, closed)
    assert truth.modes[0] == mode
    assert sorted(truth.modes) == sorted(MODES)
    for row, name in enumerate(truth.modes):
        twin = load_object("custom_door", mode=name)
        assert np.allclose(truth.flows[row], FlowOracle(twin).flow(points, POSE, closed).flows[0])
    push, pull = (truth.modes.index(f"{word}_left") for word in ("push", "pull"))
    agreement = np.sum(truth.flows[push] * truth.flows[pull], axis=1)
    assert agreement.mean() < -0.2, "push and pull are opposite"


def test_other_modes_of_an_open_door_turn_about_the_leafs_own_edges(rng):
    model = load_object("custom_door", mode="pull_left")
    positions = {"hinge": 0.8}
    displacement = POSE @ model.displacement("leaf", positions)
    points = surface(model, "leaf", positions, rng, 300)
    truth = FlowOracle(model).flow(points, POSE, positions)
    for row, name in enumerate(truth.modes):
        hinge = model.alternatives[name]
        on_axis = apply(displacement, hinge.point)
        far = np.linalg.norm((points - on_axis)[:, :2], axis=1)
        speed = np.linalg.norm(truth.flows[row], axis=1)
        assert np.allclose(speed / speed.max(), far / far.max(), atol=0.02)


def test_points_far_from_the_object_have_no_flow():
    model = load_object("drawer")
    far = np.array([[5.0, 0, 0], [0, 0, 3.0]])
    assert not FlowOracle(model).flow(far, POSE, model.closed()).flows.any()


@pytest.mark.parametrize("bad", [np.zeros((0, 3)), np.zeros((4, 2)), np.full((3, 3), np.nan)])
def test_bad_clouds_are_refused(bad):
    model = load_object("drawer")
    with pytest.raises(InvalidCloudError):
        FlowOracle(model).flow(bad, POSE, model.closed())
