"""The robot's own states: how it starts, how it is recovered, and what a pulled cable does.

Everything goes through the stand-in, which refuses and raises where panda-python 1.1.1 and
libfranka 0.9.2 do.
"""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from franka_suction_driver.backends.mock import IncompatibleVersionError
from franka_suction_driver.backends.mock_modes import RobotMode
from franka_suction_driver.backends.protocol import NOTHING_TO_RECOVER, BackendError

STATES = {
    "reflex": (RobotMode.kReflex, {"cartesian_reflex"}, "cartesian_reflex"),
    "user stop": (RobotMode.kUserStopped, set(), "user stop is pressed: release it"),
    "guiding": (RobotMode.kGuiding, set(), "guided by hand: let go"),
    "locked": (RobotMode.kOther, set(), "unlock the joints in Desk"),
    "recovering": (RobotMode.kAutomaticErrorRecovery, set(), "wait until it is done"),
    "moved by another": (RobotMode.kMove, set(), "end that program"),
}


@pytest.fixture
def fresh(make_lab: Callable[..., Any]) -> Any:
    """A robot that nobody has connected to."""
    return make_lab()


@pytest.fixture
def lab(fresh: Any) -> Any:
    fresh.arm.connect()
    return fresh


@pytest.mark.parametrize("state", STATES)
def test_a_robot_is_connected_in_any_state_and_its_remedy_is_said(fresh: Any, state: str) -> None:
    """Thresholds were set before the mode was read.

    A robot in a reflex or with the user stop pressed refused them, and the message was "cannot
    reach the robot; is the cable in the control unit's port".
    """
    mode, errors, words = STATES[state]
    fresh.robot.mode, fresh.robot.errors = mode, set(errors)
    fresh.arm.connect()
    seen = fresh.arm.state()
    assert seen is not None
    assert seen.fresh
    assert words in seen.fault
    assert "arm/recover" in seen.fault
    assert fresh.robot.names() == ["Panda"], "nothing is set, started or recovered by itself"
    fresh.robot.q = fresh.robot.q + 0.1
    fresh.sleep(0.01)
    np.testing.assert_allclose(fresh.arm.state().positions, fresh.robot.q)
    assert words in fresh.arm.follow(fresh.move())


@pytest.mark.parametrize("state", ["user stop", "guiding", "locked"])
def test_only_a_human_ends_what_a_human_began(fresh: Any, state: str) -> None:
    """A recovery that was asked for said "not connected" for ever, whatever the robot was in."""
    mode, errors, words = STATES[state]
    fresh.robot.mode, fresh.robot.errors = mode, set(errors)
    fresh.arm.connect()
    assert words in fresh.arm.recover()
    assert fresh.robot.names() == ["Panda"]
    fresh.robot.mode = RobotMode.kIdle
    assert fresh.arm.recover() == ""
    assert fresh.robot.names()[1:] == ["set_collision_behavior", "start_controller"]
    assert fresh.arm.follow(fresh.move()) == ""


def test_a_reflex_at_start_is_recovered_on_request_and_then_set_up(fresh: Any) -> None:
    """A robot that was switched on in a reflex could never be recovered by arm_node."""
    fresh.robot.mode, fresh.robot.errors = RobotMode.kReflex, {"joint_reflex"}
    fresh.arm.connect()
    assert fresh.arm.recover() == ""
    done = fresh.robot.names()
    assert done[-3:] == ["automatic_error_recovery", "set_collision_behavior", "start_controller"]
    trajectory = fresh.move()
    assert fresh.arm.follow(trajectory) == ""
    fresh.feed(float(trajectory.times[-1]) + 0.1)
    np.testing.assert_allclose(fresh.robot.q, trajectory.positions[-1])


def test_an_error_that_needs_a_hand_is_named_with_its_remedy(fresh: Any) -> None:
    fresh.robot.mode, fresh.robot.errors = RobotMode.kReflex, {"joint_reflex"}
    fresh.robot.recovers = False
    fresh.arm.connect()
    said = fresh.arm.recover()
    assert "joint_reflex" in said
    assert "manual error recovery required" in said
    assert "by hand in Desk" in said


def test_the_fault_follows_the_state_that_the_robot_is_in_now(fresh: Any) -> None:
    """The remedy of a reflex is no help to somebody who has pressed the user stop meanwhile."""
    fresh.robot.mode, fresh.robot.errors = RobotMode.kReflex, {"joint_reflex"}
    fresh.arm.connect()
    fresh.robot.mode, fresh.robot.errors = RobotMode.kUserStopped, set()
    assert "user stop" in fresh.arm.state().fault
    fresh.robot.mode = RobotMode.kIdle
    assert "arm/recover" in fresh.arm.state().fault, "it does not end by itself"


def test_recover_without_a_fault_leaves_a_moving_arm_alone(lab: Any) -> None:
    """`arm/recover` with nothing wrong stopped the controller at 1.34 rad/s."""
    trajectory = lab.move(by=1.0)
    assert lab.arm.follow(trajectory) == ""
    lab.feed(0.5 * float(trajectory.times[-1]))
    before, moving = lab.robot.names(), lab.robot.dq.copy()
    assert np.abs(moving).max() > 0.5
    assert lab.arm.recover() == NOTHING_TO_RECOVER
    assert lab.robot.names() == before
    np.testing.assert_array_equal(lab.robot.dq, moving)
    lab.feed(float(trajectory.times[-1]))
    np.testing.assert_allclose(lab.robot.q, trajectory.positions[-1])


@pytest.mark.parametrize("end", ["recover", "close"])
def test_the_controller_is_stopped_at_rest(lab: Any, end: str) -> None:
    """The controller was stopped in the same instant as braking began, at full speed.

    After the force limit has tripped, the arm still brakes when somebody asks for a recovery.
    """
    trajectory = lab.move(by=1.0)
    lab.arm.follow(trajectory)
    lab.feed(0.5 * float(trajectory.times[-1]))
    if end == "recover":
        lab.robot.wrench = np.array([50.0, 0, 0, 0, 0, 0])
        lab.arm.feed()
        lab.robot.wrench = np.array([0.1, 0, 0, 0, 0, 0])
        assert "force limit" in lab.arm.state().fault
        assert np.abs(lab.robot.dq).max() > 0.5
        assert lab.arm.recover() == ""
    else:
        lab.arm.close()
    assert "stop_controller" in lab.robot.names()
    assert lab.robot.stopped_at == 0.0


def pulled_while_moving(lab: Any) -> None:
    lab.arm.follow(lab.move(by=1.0))
    lab.feed(0.5)
    lab.robot.unplug()


def test_a_pulled_cable_is_a_fault_with_its_name_and_recover_reconnects(lab: Any) -> None:
    """RuntimeError of a dead link ended arm_node, or stayed for ever as "not connected"."""
    pulled_while_moving(lab)
    where = lab.robot.q.copy()
    lab.feed(2.0)
    fault = lab.arm.state().fault
    assert fault.startswith("the connection to the robot was lost: libfranka: UDP receive")
    assert "cable" in fault
    assert lab.arm.follow(lab.move()) == fault
    assert "cannot reach the robot" in lab.arm.recover(), "still unplugged"
    lab.robot.plug_in()
    assert lab.arm.recover() == ""
    assert lab.robot.names().count("Panda") == 3, "an object of a dead connection stays dead"
    assert "automatic_error_recovery" in lab.robot.names(), "it has stopped by a reflex"
    lab.feed(0.2)
    np.testing.assert_allclose(lab.robot.q, where)
    state = lab.arm.state()
    assert state.fault == ""
    assert state.fresh
    trajectory = lab.move()
    assert lab.arm.follow(trajectory) == ""
    lab.feed(float(trajectory.times[-1]) + 0.1)
    np.testing.assert_allclose(lab.robot.q, trajectory.positions[-1])


def test_states_of_a_pulled_cable_are_never_given_as_new(lab: Any) -> None:
    """Libfranka waits a second for packets; all that time the last state was published as new."""
    assert lab.arm.state().fresh
    pulled_while_moving(lab)
    lab.arm.state()
    while lab.arm.feed():
        state = lab.arm.state()
        assert not state.fresh
    # Within a tenth of a second the operator learns why.
    assert lab.arm.state().fault
    lab.sleep(5.0)
    assert not lab.arm.state().fresh


def test_an_arm_that_is_not_heard_of_brakes_before_the_library_gives_up(lab: Any) -> None:
    """Frozen states looked like an arm that does not follow: "0.15 rad off its target"."""
    pulled_while_moving(lab)
    lab.feed(0.3)
    assert "no new state from the robot for 0.1 s" in lab.arm.state().fault
    lab.feed(2.0)
    assert "connection to the robot was lost" in lab.arm.state().fault


def test_after_a_reflex_the_state_is_read_again(lab: Any) -> None:
    """The trap: a control loop that has died counts as running until stop_controller is called.

    Until then every read returns the last state before the reflex, as if it were new.
    """
    lab.robot.reflex("cartesian_reflex")
    lab.arm.feed()
    for _ in range(3):
        lab.robot.q = lab.robot.q + 0.1
        lab.sleep(0.01)
        state = lab.arm.state()
        np.testing.assert_allclose(state.positions, lab.robot.q)
        assert state.fresh


@pytest.mark.parametrize("stopped", [False, True])
def test_giving_up_a_dead_connection_does_not_end_the_process(lab: Any, stopped: bool) -> None:
    """The trap: Panda's destructor stops the controller; the second stop reads the robot.

    On a dead connection that read raises in a destructor, which ends the process.
    """
    if stopped:
        # A fault that leaves the robot without a controller, and then the cable.
        lab.robot.reflex("cartesian_reflex")
        lab.arm.feed()
    lab.robot.unplug()
    lab.feed(2.0)
    lab.arm.state()
    assert "connection to the robot was lost" in lab.arm.state().fault
    lab.robot.plug_in()
    assert lab.arm.recover() == ""
    gc.collect()
    assert lab.robot.crash == ""


CALLS: dict[str, Callable[[Any], object]] = {
    "get_state": lambda lab: lab.arm.state(),
    "ok": lambda lab: lab.feed(2.0),
    "stop_controller": lambda lab: lab.arm.close(),
    "recover": lambda lab: lab.arm.recover(),
    "automatic_error_recovery": lambda lab: lab.arm.recover(),
    "set_collision_behavior": lambda lab: lab.arm.recover(),
    "start_controller": lambda lab: lab.arm.recover(),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_cable_that_is_pulled_at_any_call_ends_nothing(lab: Any, name: str) -> None:
    """Whichever call the cable is pulled at: no exception, a fault, and a way back."""
    if name not in ("ok", "stop_controller"):
        lab.robot.reflex("cartesian_reflex")
        lab.arm.feed()
    lab.robot.on_call[name] = lab.robot.unplug
    CALLS[name](lab)
    assert not lab.robot.on_call, f"{name} was not called"
    if name == "stop_controller":
        assert not lab.arm.feed()
        return
    lab.feed(2.0)
    assert "connection to the robot was lost" in lab.arm.state().fault
    for call in (lab.arm.hold, lab.arm.tare, lambda: lab.arm.follow(lab.move()), lab.arm.feed):
        call()
    assert lab.arm.tare()
    lab.robot.plug_in()
    assert lab.arm.recover() == ""
    assert lab.arm.follow(lab.move()) == ""
    lab.arm.close()
    gc.collect()
    assert lab.robot.crash == ""


@pytest.mark.parametrize("name", ["Panda", "read_once", "set_collision_behavior", "recover"])
def test_a_cable_that_is_pulled_while_connecting_is_tried_again(fresh: Any, name: str) -> None:
    """Only BackendError may leave connect: the node's worker retries on nothing else."""
    fresh.robot.on_call[name] = fresh.robot.unplug
    with pytest.raises(BackendError, match=r"cannot reach|was lost"):
        fresh.arm.connect()
    fresh.robot.plug_in()
    fresh.arm.connect()
    assert fresh.arm.state().fault == ""


def test_a_robot_whose_mode_changes_while_it_is_set_up_is_a_fault(fresh: Any) -> None:
    """Between reading the mode and setting thresholds somebody may press the user stop."""
    fresh.robot.on_call["set_collision_behavior"] = fresh.robot.press_user_stop
    fresh.arm.connect()
    assert "user stop" in fresh.arm.state().fault
    assert "start_controller" not in fresh.robot.names()
    fresh.robot.mode = RobotMode.kIdle
    assert fresh.arm.recover() == ""


def test_a_start_that_the_robot_refuses_is_heard_of(fresh: Any) -> None:
    """The trap: start_controller returns; the refusal waits in the control thread."""
    fresh.robot.on_call["start_controller"] = fresh.robot.press_user_stop
    fresh.arm.connect()
    fresh.feed(0.1)
    assert "user stop" in fresh.arm.state().fault


def test_what_keeps_from_connecting_is_told_apart(fresh: Any) -> None:
    """All of these are RuntimeErrors; only FCI, cable and version ask for different hands."""
    off = "Connection to FCI refused. Please install FCI feature or enable FCI mode in Desk."
    cases: dict[str, RuntimeError] = {
        "is on, but its FCI is off.*activate FCI in Desk": RuntimeError(f"libfranka: {off}"),
        "panda-python for libfranka 0.8.0": IncompatibleVersionError("server version 4", "0.8.0"),
        "cannot reach.*ping 172.16.0.2": RuntimeError("libfranka: Connection error: No route"),
    }
    for words, error in cases.items():
        fresh.robot.refusal = error
        with pytest.raises(BackendError, match=words):
            fresh.arm.connect()


def test_a_reconnection_that_takes_long_does_not_block_the_node(
    make_lab: Callable[..., Any],
) -> None:
    """Libfranka waits up to a minute for a robot that is switched off; the service must not."""
    lab = make_lab(recovery_timeout=0.1)
    lab.arm.connect()
    lab.robot.unplug()
    lab.feed(2.0)
    arrived, gate = threading.Event(), threading.Event()

    def answer_late() -> None:
        arrived.set()
        assert gate.wait(10.0)

    lab.robot.on_call["Panda"] = answer_late
    assert "has not answered within 0.1 s" in lab.arm.recover()
    assert arrived.wait(10.0)
    assert not lab.arm.state().fresh
    lab.robot.plug_in()
    gate.set()
    deadline = time.monotonic() + 10.0
    while said := lab.arm.recover():
        assert "has not answered" in said
        assert time.monotonic() < deadline
    assert lab.robot.names().count("Panda") == 2, "the attempt that went on is the one in use"
