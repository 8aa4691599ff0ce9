"""The arm's world: tracking, forces, contacts, suction, resets, repeatability."""

import hashlib
import json
import subprocess
import sys

import numpy as np
import pytest

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.motion import JointTrajectory
from flowbothd_common.transforms import transform
from sim_bridge.objects import load_object
from sim_bridge.world import ArmWorld, ArmWorldParams

FULL = 60_000.0
START = np.array(ArmWorldParams().start)


def move(world, change, seconds, joint=0):
    """A smooth trajectory that changes one joint by `change` [rad]."""
    goal = np.zeros(7)
    goal[joint] = change
    return towards(world, goal, seconds)


def lift(world, height, seconds):
    """A smooth trajectory that moves the tip straight up [m], the tool staying vertical."""
    plane = [1, 3, 5]
    pose, columns = world.object_pose, []
    start = world.tip_pose()
    # All three axes are horizontal here: a little turn each, and the plane's Jacobian is known.
    for joint in plane:
        world.reset(object_pose=pose, joint_positions=START + 1e-4 * np.eye(7)[joint])
        tip = world.tip_pose()
        moved = tip[:3, 3] - start[:3, 3]
        columns.append(np.array([moved[0], moved[2], tip[0, 2] - start[0, 2]]) / 1e-4)
    world.reset(object_pose=pose)
    change = np.zeros(7)
    change[plane] = np.linalg.solve(np.column_stack(columns), (0.0, height, 0.0))
    return towards(world, change, seconds)


def towards(world, change, seconds):
    goal = (world.joint_state()[0] + change)[None]
    zero = np.zeros((1, 7))
    return JointTrajectory(world.joint_names, np.array([seconds]), goal, zero, zero)


@pytest.fixture
def world(robot_urdf):
    """The arm and the ambiguous door at its default pose."""
    with ArmWorld(robot_urdf, load_object("custom_door", mode="pull_left")) as made:
        yield made


@pytest.fixture
def over_lid(robot_urdf):
    """The arm with its tip 2 mm over the lid of a box, near the lid's free edge."""
    model = load_object("lidded_box")
    with ArmWorld(robot_urdf, model) as made:
        made.reset(object_pose=under_tip(made, 0.002))
        yield made


def under_tip(world, gap):
    tip = world.tip_pose()[:3, 3]
    top = world.model.bounds()[1, 2]
    return transform(translation=(tip[0] + 0.06, 0.0, tip[2] - gap - top))


def test_it_rests_at_the_start_pose_without_touching_anything(world):
    world.step(240)
    positions, velocities = world.joint_state()
    assert world.time == pytest.approx(1.0)
    assert np.abs(positions - START).max() < 1e-5
    assert np.abs(velocities).max() < 1e-3
    assert world.open_ratios() == {"hinge": 0.0}
    assert not world.wrench().any()
    assert world.worst_contacts() == {}


def test_the_arm_follows_its_trajectory_within_a_millimetre(world):
    trajectory = move(world, 0.4, 1.0)
    assert world.command_trajectory(trajectory) == ""
    worst = 0.0
    for _ in range(300):
        wanted = world._follower.sample(world.time + world.params.time_step).position
        world.step()
        positions, _ = world.joint_state()
        worst = max(worst, np.abs(positions - wanted).max())
    # The arm is less than a metre long.
    assert worst < 1e-3
    assert np.allclose(world.joint_state()[0], trajectory.positions[-1], atol=1e-4)


def test_a_bad_trajectory_is_refused_and_nothing_moves(world):
    bad = JointTrajectory(("elbow",), np.ones(1), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros(1))
    assert "unknown joints ['elbow']" in world.command_trajectory(bad)
    world.step(20)
    assert np.abs(world.joint_state()[0] - START).max() < 1e-5


def test_hold_brings_it_to_rest(world):
    world.command_trajectory(move(world, 0.5, 1.0))
    world.step(120)
    assert np.abs(world.joint_state()[1]).max() > 0.5
    world.hold()
    world.step(60)
    stopped = world.joint_state()[0]
    assert np.abs(world.joint_state()[1]).max() < 1e-3
    world.step(60)
    assert np.allclose(world.joint_state()[0], stopped, atol=1e-5)


def test_the_cup_lifts_the_lid_and_feels_its_weight(over_lid):
    world = over_lid
    trajectory = lift(world, 0.02, 1.5)
    world.command_suction(FULL)
    world.step(60)
    assert world.suction().part_present
    assert world.cup.attached
    assert world.command_trajectory(trajectory) == ""
    world.step(420)
    assert world.open_ratios()["hinge"] > 0.05
    force = world.wrench()[:3]
    # The lid (0.35 kg) hangs between its hinge and the cup, which stands about 17 cm from it.
    assert -4.0 < force[2] < -1.0, "the environment pulls the tool down"
    assert world.observation().vacuum


def test_released_the_lid_falls_shut(over_lid):
    world = over_lid
    trajectory = lift(world, 0.02, 1.0)
    world.command_suction(FULL)
    world.step(60)
    world.command_trajectory(trajectory)
    world.step(300)
    opened = world.open_ratios()["hinge"]
    world.command_suction(0.0)
    world.step(240)
    assert opened > 0.02
    assert world.open_ratios()["hinge"] == pytest.approx(0.0, abs=1e-3)
    assert not world.suction().part_detached
    assert not world.wrench().any()


def test_pulling_across_shears_the_cup_off_and_is_reported(over_lid):
    world = over_lid
    world.command_suction(FULL)
    world.step(60)
    world.command_trajectory(move(world, 0.3, 1.0))
    world.step(240)
    assert "sheared off" in world.cup.loss_reason
    assert world.observation().vacuum_lost
    assert not world.observation().vacuum


def test_a_dry_cup_presses_with_its_spring(over_lid):
    world = over_lid
    world.command_trajectory(lift(world, -0.004, 1.0))
    world.step(300)
    depth = world.object_pose[2, 3] + world.model.bounds()[1, 2] - world.tip_pose()[2, 3]
    assert depth > 0.0005
    assert world.wrench()[2] == pytest.approx(3000 * depth, rel=0.1), "the lid pushes the tool up"
    assert world.worst_contacts() == {}, "the cup's own contact is meant"


def test_a_collision_of_the_arm_is_named_with_its_force(over_lid):
    world = over_lid
    world.command_trajectory(move(world, 0.5, 1.0, joint=1))
    world.step(240)
    worst = world.worst_contacts()
    assert worst
    tool = {"suction_body", "suction_stem"}
    assert {link for link, _ in worst} <= {*tool, "panda_link7", "panda_link6"}
    assert {thing for _, thing in worst} <= {"lid", "box"}
    assert max(worst.values()) > 5.0
    now = world.contacts()
    assert now
    felt = np.sum([c.force for c in now if c.robot_link in tool], axis=0)
    pressed = world.wrench()[:3] - felt
    assert np.linalg.norm(pressed) < np.linalg.norm(world.wrench()[:3]), (
        "contacts are in the wrench"
    )


def test_reset_puts_everything_back_and_takes_another_object(world):
    world.command_trajectory(move(world, 0.3, 0.5))
    world.command_suction(FULL)
    world.set_object_positions({"hinge": 0.5})
    world.step(100)
    assert world.open_ratio > 0.1
    pose = world.object_pose
    world.reset()
    assert world.time == 0.0
    assert world.open_ratio == 0.0
    assert np.array_equal(world.object_pose, pose)
    assert np.allclose(world.joint_state()[0], START)
    assert world.suction().vacuum == 0.0
    drawer = load_object("drawer")
    world.reset(drawer)
    assert np.array_equal(world.object_pose, drawer.default_pose)
    assert list(world.open_ratios()) == ["slide"]
    leaf = world.ground_truth_flow([[0.5, 0.0, 0.1], [0.45, 0.0, 0.1]])
    assert leaf.modes == ("truth",)


def test_everything_that_can_be_seen_has_a_pose(world):
    world.set_object_positions({"hinge": 0.5})
    names = {part.name for part in world.parts()}
    poses = world.part_poses()
    assert names == set(poses)
    assert {
        "table",
        "object/leaf",
        "object/frame",
        "robot/panda_link0",
        "robot/suction_cup",
    } <= names
    assert np.allclose(poses["robot/panda_link0"], np.eye(4))
    assert not np.allclose(poses["object/leaf"], poses["object/frame"])
    cup = poses["robot/suction_cup"]
    assert np.allclose(cup[:3, 2], world.tip_pose()[:3, 2])


def test_a_robot_without_the_named_links_is_refused(robot_urdf):
    params = ArmWorldParams(tip="finger")
    with pytest.raises(ObjectModelError, match=r"got \['finger'\]") as caught:
        ArmWorld(robot_urdf, load_object("drawer"), params=params)
    assert "suction_tip" in str(caught.value)


def fingerprint(urdf):
    """Hash of the states of a run with contact, suction and a reset."""
    digest = hashlib.sha256()
    with ArmWorld(urdf, load_object("lidded_box")) as world:
        for _ in range(2):
            world.reset(object_pose=under_tip(world, 0.002))
            world.command_suction(FULL)
            world.step(40)
            world.command_trajectory(move(world, -0.05, 1.0, joint=1))
            for _ in range(260):
                world.step()
                state = (*world.joint_state(), world.wrench())
                digest.update(np.concatenate(state).tobytes())
                digest.update(json.dumps(world.object_positions()).encode())
    return digest.hexdigest()


@pytest.mark.long
def test_equal_runs_are_bit_identical_here_and_in_another_process(robot_urdf, tmp_path):
    first = fingerprint(robot_urdf)
    assert fingerprint(robot_urdf) == first
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(robot_urdf)
    code = (
        "import importlib.util, pathlib, sys\n"
        "spec = importlib.util.spec_from_file_location('t', sys.argv[1])\n"
        "t = importlib.util.module_from_spec(spec)\n"
        "spec.loader.exec_module(t)\n"
        "sys.stdout.write(t.fingerprint(pathlib.Path(sys.argv[2]).read_text()))\n"
    )
    other = subprocess.run(
        [sys.executable, "-c", code, __file__, str(urdf)],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert other.stdout.strip().endswith(first)
