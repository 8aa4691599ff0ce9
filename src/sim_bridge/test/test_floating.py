"""The floating gripper: the paper's rollout, its failures, its repeatability."""

import hashlib
import json
import subprocess
import sys

import numpy as np
import pytest

from flowbothd_common.errors import MotionRejectedError
from flowbothd_common.motion import MotionGoal, MotionKind, MotionReason
from sim_bridge.floating import FloatingParams, FloatingWorld
from sim_bridge.objects import load_object
from sim_bridge.objects.custom_door import MODES

ON = 60_000.0


def go(world, kind, direction=None, contact=None, distance=0.0):
    return world.execute(MotionGoal(kind, contact, direction, distance))


def grasp(world, contact, direction):
    """Approach along the flow and probe until something is held; the probe's result."""
    world.command_suction(0.0)
    go(world, MotionKind.APPROACH, direction, contact)
    world.command_suction(ON)
    return go(world, MotionKind.PROBE, -direction)


def rollout(model, seed, steps=30):
    """Open the target joint under true flow, gripping where it is largest.

    Returns the open ratio, the number of steps, and a hash of everything on the way.
    """
    digest = hashlib.sha256()
    with FloatingWorld(model, seed) as world:
        taken = 0
        while taken < steps and world.open_ratio <= 0.9:
            taken += 1
            seen = world.observe()
            flow = world.ground_truth_flow(seen.points, target_only=True).flows[0]
            best = int(np.argmax(np.linalg.norm(flow, axis=1)))
            direction = flow[best].astype(float)
            if world.held_link() is None:
                grasp(world, seen.points[best].astype(float), direction)
            result = go(world, MotionKind.FLOW_STEP, direction)
            digest.update(seen.points.tobytes() + result.tool_end.tobytes())
            digest.update(json.dumps(world.object_positions()).encode())
        return world.open_ratio, taken, digest.hexdigest()


@pytest.mark.parametrize(
    ("name", "mode"),
    [
        *(("custom_door", mode) for mode in MODES),
        ("drawer", None),
        ("cabinet_door", "left"),
        ("cabinet_door", "right"),
        ("lidded_box", None),
    ],
)
def test_true_flow_opens_every_object_in_every_mode(name, mode):
    ratio, steps, _ = rollout(load_object(name, mode=mode), seed=0)
    assert ratio > 0.9
    assert steps <= 10


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("number", "link"),
    [(8994, "link_2"), *((41083, f"link_{i}") for i in range(4))],
)
def test_true_flow_opens_every_published_hinge_and_drawer(raw_object, number, link, seed):
    ratio, _, _ = rollout(raw_object(number).with_target(link), seed)
    assert ratio > 0.9


def test_true_flow_opens_a_published_door(raw_object):
    ratio, steps, _ = rollout(raw_object(8994), seed=1)
    assert ratio > 0.9
    assert steps <= 10


@pytest.mark.long
def test_seeds_repeat_bit_by_bit_here_and_in_another_process():
    model = load_object("custom_door", mode="push_left")
    first = rollout(model, 3)
    assert rollout(model, 3) == first
    assert rollout(model, 4) != first
    code = (
        "import importlib.util, sys\n"
        "spec = importlib.util.spec_from_file_location('t', sys.argv[1])\n"
        "t = importlib.util.module_from_spec(spec)\n"
        "spec.loader.exec_module(t)\n"
        "model = t.load_object('custom_door', mode='push_left')\n"
        "sys.stdout.write(t.rollout(model, 3)[2])\n"
    )
    other = subprocess.run(
        [sys.executable, "-c", code, __file__],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert other.stdout.strip().endswith(first[2])


@pytest.fixture
def door():
    with FloatingWorld(load_object("custom_door", mode="pull_left")) as world:
        yield world


LEAF = np.array([-0.00875, -0.05, 0.25])
PULL = np.array([-1.0, 0.0, 0.0])


def test_one_motion_after_another(door):
    approach = go(door, MotionKind.APPROACH, PULL, LEAF)
    assert approach.reason is MotionReason.REACHED
    assert np.allclose(approach.tool_end[:3, 3], LEAF + 0.2 * PULL)
    assert np.allclose(approach.tool_end[:3, 2], -PULL)
    door.command_suction(ON)
    probe = go(door, MotionKind.PROBE, -PULL)
    assert probe.reason is MotionReason.VACUUM
    assert probe.vacuum
    assert door.suction().part_present
    assert door.held_link() == "leaf"
    assert np.linalg.norm(probe.tool_end[:3, 3] - LEAF) < 0.004
    step = go(door, MotionKind.FLOW_STEP, PULL, distance=0.05)
    assert step.reason is MotionReason.REACHED
    assert 0.8 < step.reached_fraction <= 1.0
    assert np.linalg.norm(step.tool_motion) == pytest.approx(0.05, abs=0.004)
    assert door.open_ratio > 0.2
    assert step.duration == pytest.approx(0.125)
    retreat = go(door, MotionKind.RETREAT)
    assert retreat.reason is MotionReason.REACHED
    assert door.held_link() is None


def test_without_suction_the_probe_only_touches(door):
    go(door, MotionKind.APPROACH, PULL, LEAF)
    touched = go(door, MotionKind.PROBE, -PULL)
    assert touched.reason is MotionReason.CONTACT
    assert touched.contact
    assert not touched.vacuum
    door.command_suction(ON)
    assert door.held_link() == "leaf", "switched on in contact"


def test_a_probe_past_the_object_finds_nothing(door):
    result = grasp(door, LEAF + np.array([0, 0, 2.0]), PULL)
    assert result.reason is MotionReason.NO_CONTACT
    assert "nothing within" in result.message
    lost = go(door, MotionKind.FLOW_STEP, PULL)
    assert lost.reason is MotionReason.SUCTION_LOST


def test_pushing_a_closed_pull_door_stalls(door):
    assert grasp(door, LEAF, PULL).vacuum
    result = go(door, MotionKind.FLOW_STEP, -PULL)
    assert np.linalg.norm(result.tool_motion) < 0.01
    assert result.reason is MotionReason.STALLED
    assert "did not follow" in result.message
    assert door.open_ratio == pytest.approx(0.0, abs=1e-3)
    assert door.held_link() == "leaf"
    # The ball is back at the part, so that the next pull starts there.
    assert np.linalg.norm(result.tool_motion) < 1e-3
    assert go(door, MotionKind.FLOW_STEP, PULL, distance=0.05).reason is MotionReason.REACHED


def test_the_frame_is_in_the_way_only_if_asked_for():
    edge = np.array([0.00875, -0.084, 0.25])
    push = np.array([0.995, -0.1, 0.0])
    held = []
    for passes in (True, False):
        model = load_object("custom_door", mode="push_left")
        with FloatingWorld(model, 0, FloatingParams(passes_others=passes)) as world:
            assert grasp(world, edge, push).vacuum
            held.append(world.held_link())
    assert held == ["leaf", "frame"]


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (MotionGoal(MotionKind.APPROACH, direction=PULL), "without a contact point"),
        (MotionGoal(MotionKind.PROBE), "probe without a direction"),
        (MotionGoal(MotionKind.FLOW_STEP, direction=np.zeros(3)), "without a direction"),
    ],
)
def test_incomplete_goals_are_refused(door, goal, words):
    with pytest.raises(MotionRejectedError, match=words):
        door.execute(goal)


def test_an_observation_is_a_draw_of_the_objects_pixels(door):
    seen = door.observe(500)
    assert seen.points.shape == (500, 3)
    assert set(seen.links) <= {"leaf", "frame", "base_plate"}
    low, high = door.model.bounds()
    assert (seen.points >= low - 1e-4).all()
    assert (seen.points <= high + 1e-4).all()
    again = door.observe(500)
    assert not np.array_equal(seen.points, again.points), "every look draws anew"
    door.reset(0)
    assert np.array_equal(door.observe(500).points, seen.points)


def test_published_objects_may_be_small_in_the_picture():
    with FloatingWorld(load_object("drawer", width=0.05, depth=0.05, height=0.05)) as world:
        assert world.observe(1200).points.shape == (1200, 3)
