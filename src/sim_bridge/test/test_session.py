"""The bridge's world over several resets, without ROS."""

import numpy as np
import pytest

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.parameters import build, specifications
from sim_bridge.params import BridgeParams
from sim_bridge.session import Session, Setup, initial_setup


@pytest.fixture
def session(robot_urdf):
    """The ambiguous door, mode and pose from parameters."""
    params = build(BridgeParams, {"mode": "push_left", "object_position": [0.6, 0.1, 0.0]})
    made = Session(robot_urdf, params, initial_setup(params))
    yield made
    made.close()


def test_parameters_choose_object_mode_and_pose(session):
    assert session.world.model.mode == "push_left"
    assert np.allclose(session.world.object_pose[:3, 3], (0.6, 0.1, 0.0))
    default = initial_setup(BridgeParams())
    assert default.pose is None


def test_every_parameter_is_described_and_its_default_valid():
    specs = list(specifications(BridgeParams))
    assert len(specs) > 25
    assert all(spec.description for spec in specs)
    values = {spec.name: spec.default for spec in specs}
    assert build(BridgeParams, values) == BridgeParams()


def test_time_goes_on_over_resets(session):
    session.world.step(100)
    before = session.time
    session.reset(Setup("drawer"))
    assert session.time > before
    assert session.world_time(session.time) == pytest.approx(0.0)
    session.world.step(10)
    assert session.time == pytest.approx(before + 11 / 240)


def test_a_refused_reset_leaves_everything_as_it_was(session):
    session.world.step(50)
    session.world.set_object_positions({"hinge": 0.3})
    state = session.time, session.world.object_positions(), session.setup
    for bad in (
        Setup("wardrobe"),
        Setup("custom_door", mode="slide"),
        Setup("custom_door", target_joint="knob"),
        Setup("drawer", pose=np.full((4, 4), np.nan)),
    ):
        with pytest.raises(ObjectModelError):
            session.reset(bad)
        assert (session.time, session.world.object_positions(), session.setup) == state


def test_the_camera_sees_the_new_object_after_a_reset(session):
    before = session.camera.render(session.world.part_poses())
    session.reset(Setup("drawer"))
    after = session.camera.render(session.world.part_poses())
    assert before.mask("object/leaf").any()
    assert "object/leaf" not in after.names
    assert after.mask("object/tray").any() or after.mask("object/chest").any()


def test_a_reset_starts_the_noise_anew(session):
    """Runs with equal seeds must see equal images."""
    images = []
    for _ in range(2):
        session.reset(Setup("custom_door", seed=5))
        session.camera.render(session.world.part_poses())
        images.append(session.camera.render(session.world.part_poses()).depth)
    assert np.array_equal(*images)
