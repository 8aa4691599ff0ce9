"""Objects: what they are made of, how they move, what is said of bad input."""

import numpy as np
import pybullet as p
import pytest

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.transforms import apply
from sim_bridge.bullet import Bullet
from sim_bridge.objects import load_object, object_modes, object_names
from sim_bridge.objects.custom_door import MODES
from sim_bridge.physics_urdf import write_object

FURNITURE = ("drawer", "cabinet_door", "lidded_box")


def at(model, ratio):
    return {j.name: j.lower + ratio * (j.upper - j.lower) for j in model.joints.values()}


def test_every_registered_object_loads_and_stands_on_the_table():
    for name in object_names():
        model = load_object(name)
        low = apply(model.default_pose, model.bounds())[0, 2]
        assert low == pytest.approx(0.0, abs=1e-12)
        assert model.target.open_ratio(model.closed()[model.target_joint]) == 0.0


def test_the_doors_dimensions_are_those_of_the_design():
    model = load_object("custom_door", mode="pull_left")
    edges = {name: np.ptp(link.mesh.vertices, axis=0) for name, link in model.links.items()}
    assert np.allclose(edges["leaf"], (0.0175, 0.1683, 0.435))
    assert np.allclose(edges["frame"], (0.085, 0.25, 0.438))
    assert np.allclose(edges["base_plate"], (0.36, 0.3175, 0.0125))
    assert np.rad2deg(model.target.upper) == pytest.approx(70.0)


def test_nothing_visible_tells_the_mode_of_the_closed_door():
    """The same coordinates to the last bit (of float32, which is what a camera casts rays at)."""
    first, *others = (load_object("custom_door", mode=mode) for mode in MODES)
    for other in others:
        assert list(other.links) == list(first.links)
        assert np.array_equal(other.default_pose, first.default_pose)
        for name, link in first.links.items():
            twin = other.links[name]
            assert np.array_equal(
                link.mesh.vertices.astype(np.float32), twin.mesh.vertices.astype(np.float32)
            )
            assert [m.color for m in link.meshes] == [m.color for m in twin.meshes]


@pytest.mark.parametrize("mode", MODES)
def test_the_door_opens_the_way_its_mode_says(mode):
    model = load_object("custom_door", mode=mode)
    leaf = model.links["leaf"].mesh.vertices
    middle_before = leaf.mean(axis=0)
    moved = apply(model.displacement("leaf", {"hinge": 0.2}), middle_before)
    # The front looks along -x; seen from there the left is +y.
    towards_front = moved[0] < middle_before[0]
    assert towards_front == mode.startswith("pull")
    assert (model.target.point[1] > 0) == mode.endswith("left")


@pytest.mark.parametrize("mode", MODES)
def test_the_leaf_clears_the_jambs_over_its_whole_range(mode):
    """A hinge in the middle of a thick leaf would drive its edge into the jamb."""
    model = load_object("custom_door", mode=mode)
    jamb_inner = 0.1683 / 2 + 0.002
    grid = np.stack(
        np.meshgrid(
            np.linspace(-0.0175 / 2, 0.0175 / 2, 8), np.linspace(-0.1683 / 2, 0.1683 / 2, 60)
        ),
        axis=-1,
    ).reshape(-1, 2)
    points = np.column_stack([grid, np.full(len(grid), 0.2)])
    for angle in np.linspace(0, model.target.upper, 60):
        moved = apply(model.displacement("leaf", {"hinge": angle}), points)
        in_depth = np.abs(moved[:, 0]) < 0.085 / 2
        assert (np.abs(moved[in_depth, 1]) < jamb_inner).all()


def test_modes_are_drawn_from_the_seed_and_all_of_them_come():
    drawn = {load_object("custom_door", seed=seed).mode for seed in range(30)}
    assert drawn == set(MODES) == set(object_modes("custom_door"))
    assert load_object("custom_door", seed=5).mode == load_object("custom_door", seed=5).mode
    assert {load_object("cabinet_door", seed=seed).mode for seed in range(9)} == {"left"}


@pytest.mark.parametrize("name", FURNITURE)
def test_furniture_varies_with_the_seed_and_opens_outwards(name):
    nominal, varied = load_object(name), load_object(name, seed=3)
    assert not np.allclose(np.ptp(nominal.bounds(), axis=0), np.ptp(varied.bounds(), axis=0))
    for model in (nominal, varied):
        closed, opened = model.bounds(), model.bounds(at(model, 1.0))
        grown = closed[0, 0] - opened[0, 0] > 0.1 or opened[1, 2] - closed[1, 2] > 0.1
        assert grown, "neither towards the front nor upwards"


def test_the_drawer_travels_22_centimetres_and_takes_other_sizes():
    assert load_object("drawer").target.upper == pytest.approx(0.22)
    assert load_object("drawer", travel=0.15).target.upper == pytest.approx(0.15)


@pytest.mark.parametrize("name", [*object_names(), "8994", "41083"])
def test_our_kinematics_are_pybullets(name, raw_object, rng):
    """Two ways to the same places: products of exponentials here, Featherstone there."""
    model = raw_object(name) if name.isdigit() else load_object(name)
    bullet = Bullet(1 / 240, 9.81)
    try:
        pose = model.default_pose
        body = bullet.load_object(model, write_object(model), pose)
        closed = {n: bullet.link_pose(body.id, body.links[n]) for n in model.links}
        positions = at(model, 0.6)
        body.set_joints(positions)
        for link in model.links:
            point = rng.normal(size=3)
            moved = bullet.link_pose(body.id, body.links[link])
            in_link = np.linalg.inv(closed[link]) @ np.append(point, 1)
            theirs = (moved @ in_link)[:3]
            zero = np.linalg.inv(model.displacement(link, model.closed()))
            local = apply(np.linalg.inv(pose), point)
            ours = apply(pose @ model.displacement(link, positions) @ zero, local)
            assert np.allclose(ours, theirs, atol=1e-6), link
    finally:
        bullet.close()


def test_published_objects_load_as_they_are_found(raw_object):
    door, cabinet = raw_object(8994), raw_object(41083)
    # The door's knob turns without limits: it has no closed state and travels with its leaf.
    assert list(door.joints) == ["joint_2"]
    assert door.links["link_1"].joints == ("joint_2",)
    kinds = {j.child: j.kind for j in cabinet.joints.values()}
    assert kinds == {
        "link_0": "revolute",
        "link_1": "revolute",
        "link_2": "prismatic",
        "link_3": "prismatic",
    }
    assert all(len(link.mesh.faces) for link in cabinet.links.values())


def test_all_collision_meshes_of_a_large_object_are_loaded(raw_object):
    """Incident: PyBullet broke lines, file names included, after 1024 characters of URDF."""
    model = raw_object(41083)
    bullet = Bullet(1 / 240, 0.0)
    try:
        body = bullet.load_object(model, write_object(model), np.eye(4))
        for link in model.links:
            index = body.links[link]
            low, high = np.array(p.getAABB(body.id, index, physicsClientId=bullet.client))
            seen = model.links[link].mesh.vertices
            assert np.allclose(low, seen.min(axis=0), atol=0.01), link
            assert np.allclose(high, seen.max(axis=0), atol=0.01), link
    finally:
        bullet.close()


def test_another_target_joint_is_chosen_by_joint_or_link(raw_object):
    model = raw_object(41083)
    assert model.with_target("link_0").target_joint == "joint_0"
    assert model.with_target("joint_3").target.child == "link_3"
    with pytest.raises(ObjectModelError, match=r"got handle.*joint_0"):
        model.with_target("handle")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"name_or_path": "dor"}, ["unknown object", "got dor", "custom_door", "mobility.urdf"]),
        (
            {"name_or_path": "custom_door", "mode": "slide"},
            ["no such mode", "got slide", "pull_left"],
        ),
        ({"name_or_path": "drawer", "mode": "left"}, ["no such mode", "none"]),
        ({"name_or_path": "drawer", "tallness": 0.3}, ["got ['tallness']", "height"]),
        ({"name_or_path": "drawer", "height": -1.0}, ["{'height': -1.0}", "> 0"]),
        ({"name_or_path": "custom_door", "leaf_width": 0.3}, ["does not fit", "0.3", "narrower"]),
    ],
)
def test_bad_requests_say_what_was_given_and_what_is_allowed(arguments, words):
    with pytest.raises(ObjectModelError) as caught:
        load_object(**arguments)
    for word in words:
        assert word in str(caught.value)


def test_a_folder_without_a_urdf_says_what_it_should_hold(tmp_path):
    with pytest.raises(ObjectModelError, match=r"0 \.urdf files .*mobility\.urdf"):
        load_object(tmp_path)
