"""The panda backend against a mock with the real library's semantics.

Each trap that facts about the hardware tell of has a test here whose docstring tells it.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flowbothd_common.errors import ParameterError
from flowbothd_common.motion import JointState
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.arm.trajectory import joint_move
from franka_suction_driver.backend_params import PandaParams
from franka_suction_driver.backends.library import INSTALL, load_panda_py
from franka_suction_driver.backends.mock import START, MockLibrary, MockRobot
from franka_suction_driver.backends.mock_modes import RobotMode
from franka_suction_driver.backends.panda import PandaArm
from franka_suction_driver.backends.protocol import BackendError
from franka_suction_driver.params import FlowStepParams, ProbeParams

PARAMS = PandaParams(robot_ip="172.16.0.2")


@pytest.fixture
def lab(make_lab: Callable[..., Any]) -> Any:
    made = make_lab()
    made.arm.connect()
    return made


def test_a_trajectory_is_fed_to_the_controller_and_followed(lab: Any) -> None:
    trajectory = lab.move()
    assert lab.arm.follow(trajectory) == ""
    lab.feed(float(trajectory.times[-1]) + 0.1)
    np.testing.assert_allclose(lab.robot.q, trajectory.positions[-1])
    assert not lab.robot.dq.any()
    state = lab.arm.state()
    assert state is not None
    assert state.fault == ""


def test_hold_brakes_within_the_limits(lab: Any) -> None:
    trajectory = lab.move(by=1.0)
    assert lab.arm.follow(trajectory) == ""
    lab.feed(0.3 * float(trajectory.times[-1]))
    assert lab.robot.dq[0] > 0.3
    lab.arm.hold()
    lab.feed(2.0)
    assert not lab.robot.dq.any()
    assert lab.robot.q[0] < trajectory.positions[-1][0] - 0.05
    assert "stop_controller" not in lab.robot.names()


def test_trajectories_that_a_controller_would_reject_are_refused_aloud(lab: Any) -> None:
    """The trap: JointTrajectoryController rejects with a line in its own log and says nothing."""
    good = lab.move()
    zero = np.zeros_like(good.velocities)
    bad = {
        "no points": replace(
            good,
            times=np.zeros(0),
            positions=np.zeros((0, 7)),
            velocities=np.zeros((0, 7)),
            accelerations=np.zeros((0, 7)),
        ),
        "does not end at rest": replace(good, velocities=zero + 0.01),
        "not strictly increasing": replace(good, times=good.times[::-1].copy()),
        "positions are": replace(good, positions=good.positions[:, :6]),
        "not finite": replace(good, positions=good.positions * np.nan),
        "begins elsewhere": replace(good, positions=good.positions + 0.5),
        "beyond a limit: velocity": replace(good, velocities=np.vstack([zero[:-1] + 9, zero[-1:]])),
    }
    for words, trajectory in bad.items():
        assert words in lab.arm.follow(trajectory)
    lab.feed(0.5)
    np.testing.assert_allclose(lab.robot.q, START)


def test_an_arm_whose_commander_has_lost_track_of_it_brakes(lab: Any) -> None:
    """The incident: the arm was held while its reference ran on, and then snapped after it."""
    assert lab.arm.follow(lab.move()) == ""
    lab.feed(0.2)
    assert np.abs(lab.robot.dq).max() > 0.1
    ahead = lab.move()
    reason = lab.arm.follow(replace(ahead, positions=ahead.positions + 0.2))
    assert "begins elsewhere" in reason
    where = lab.robot.q.copy()
    lab.feed(2.0)
    assert not lab.robot.dq.any()
    assert np.abs(lab.robot.q - where).max() < 0.15
    assert lab.arm.state().fault == "", "nothing is broken: the next good one is followed"


def test_a_reflex_is_not_recovered_by_the_next_command(lab: Any) -> None:
    """The trap: start_controller and move_* call recover() first.

    After a collision the next command then clears the error without a word and moves on.
    """
    lab.robot.reflex("cartesian_reflex")
    assert not lab.arm.feed()
    before = lab.robot.names().count("start_controller")
    assert "cartesian_reflex" in lab.arm.follow(lab.move())
    lab.arm.hold()
    assert "automatic_error_recovery" not in lab.robot.names()
    assert lab.robot.names().count("start_controller") == before
    assert lab.arm.recover() == ""
    assert "automatic_error_recovery" in lab.robot.names()
    assert lab.arm.follow(lab.move()) == ""


def test_a_robot_that_stands_in_an_error_is_not_recovered_by_connecting(
    make_lab: Callable[..., Any],
) -> None:
    """The trap: starting a controller recovers automatically, also the very first time."""
    lab = make_lab()
    lab.robot.mode, lab.robot.errors = RobotMode.kReflex, {"joint_reflex"}
    lab.arm.connect()
    assert "start_controller" not in lab.robot.names()
    state = lab.arm.state()
    assert state is not None
    assert "joint_reflex" in state.fault
    assert "arm/recover" in state.fault
    assert lab.arm.recover() == ""
    assert lab.arm.state().fault == ""


def test_the_user_stop_must_be_released_by_hand(lab: Any) -> None:
    """The trap: recover() does nothing for kUserStopped and does not say so."""
    lab.robot.press_user_stop()
    lab.feed(0.1)
    assert "user stop" in lab.arm.follow(lab.move())
    assert "release it" in lab.arm.recover()
    assert "recover" not in lab.robot.names()
    lab.robot.mode = RobotMode.kIdle
    assert lab.arm.recover() == ""


def test_a_failed_recovery_stays_a_fault(lab: Any) -> None:
    lab.robot.recovers = False
    lab.robot.reflex("joint_reflex")
    lab.arm.feed()
    assert "joint_reflex" in lab.arm.recover()
    assert lab.arm.follow(lab.move())


def test_an_error_that_is_told_only_once_is_kept(lab: Any) -> None:
    """The trap: ctx.ok() raises a stored exception once; whoever asks again hears all is well."""
    lab.robot.reflex("communication_constraints_violation")
    assert not lab.arm.feed()
    assert lab.robot.pending is None
    for _ in range(3):
        state = lab.arm.state()
        assert state is not None
        assert "communication_constraints_violation" in state.fault
        assert "real-time" in state.fault


def test_the_state_is_read_anew_where_no_controller_refreshes_it(lab: Any) -> None:
    """The trap: without a running controller get_state() returns an old copy."""
    lab.robot.reflex("cartesian_reflex")
    lab.arm.feed()
    lab.robot.q = lab.robot.q + 0.3
    state = lab.arm.state()
    assert state is not None
    np.testing.assert_allclose(state.positions, lab.robot.q)


def test_the_wrench_is_what_the_environment_does_to_the_tool(lab: Any) -> None:
    """The trap: O_F_ext_hat_K counts what the ROBOT does to the environment as positive."""
    lab.robot.wrench = np.array([0, 0, 10.0, 0, 0, 0])
    lab.robot.tip[:3, 3] = lab.arm._kinematics.tip(lab.robot.q).position
    lab.feed(0.01)
    wrench = lab.arm.state().wrench
    np.testing.assert_allclose(wrench, [0, 0, -10.0, 0, 0, 0], atol=1e-9)


def test_the_torque_is_moved_to_our_tip(lab: Any) -> None:
    """The trap: the torque is about frame K, which Desk places, not about our cup."""
    tip = lab.arm._kinematics.tip(lab.robot.q).position
    lab.robot.tip[:3, 3] = tip - [0, 0, 0.05]
    lab.robot.wrench = np.array([-10.0, 0, 0, 0, 0, 0])
    lab.feed(0.01)
    # Ten newtons along x, five centimetres below the tip.
    np.testing.assert_allclose(lab.arm.state().wrench, [10, 0, 0, 0, -0.5, 0], atol=1e-9)


def test_a_wrench_of_zeros_is_no_wrench(lab: Any) -> None:
    """The trap: near a singularity libfranka reports all zeros, which looks like no contact."""
    lab.robot.wrench = np.zeros(6)
    lab.feed(0.01)
    assert lab.arm.state().wrench is None
    assert "singularity" in lab.arm.tare()


def test_a_wrench_near_a_singularity_is_not_believed(make_lab: Callable[..., Any]) -> None:
    """The trap: close to the zeros the estimate is wrong without being zero."""
    lab = make_lab(least_conditioning=10.0)
    lab.arm.connect()
    lab.robot.wrench = np.array([5.0, 0, 0, 0, 0, 0])
    lab.feed(0.01)
    assert lab.arm.state().wrench is None


def test_taring_removes_the_offset(lab: Any) -> None:
    """The trap: a wrong end-effector mass in Desk shows as a force without any contact."""
    lab.robot.tip[:3, 3] = lab.arm._kinematics.tip(lab.robot.q).position
    lab.robot.wrench = np.array([1.0, 2.0, 3.0, 0, 0, 0])
    lab.feed(0.01)
    assert lab.arm.tare() == ""
    lab.robot.wrench = np.array([1.0, 2.0, -4.0, 0, 0, 0])
    lab.feed(0.01)
    np.testing.assert_allclose(lab.arm.state().wrench[:3], [0, 0, 7.0], atol=1e-9)


def test_collision_thresholds_are_set_before_anything_moves(lab: Any) -> None:
    """The trap: the defaults are 10 to 20 N, far below what a drawer needs: a reflex at once."""
    names = lab.robot.names()
    assert names.index("set_collision_behavior") < names.index("start_controller")
    arguments = dict(lab.robot.calls)["set_collision_behavior"]
    lower_torques, upper_torques, lower_forces, upper_forces = arguments
    assert upper_forces == [70.0] * 6
    assert upper_torques[4:] == [12.0] * 3
    assert all(low < high for low, high in zip(lower_forces, upper_forces, strict=True))
    assert all(low < high for low, high in zip(lower_torques, upper_torques, strict=True))


def test_our_force_limit_trips_first_brakes_and_latches(lab: Any) -> None:
    """The trap: the robot's own reflex fires before a softer limit above its threshold can."""
    trajectory = lab.move(by=1.0)
    lab.arm.follow(trajectory)
    lab.feed(0.5 * float(trajectory.times[-1]))
    lab.robot.wrench = np.array([50.0, 0, 0, 0, 0, 0])
    lab.feed(2.0)
    assert not lab.robot.dq.any()
    assert "force limit: 50 N" in lab.arm.state().fault
    lab.robot.wrench = np.array([1.0, 0, 0, 0, 0, 0])
    lab.feed(0.1)
    assert lab.arm.follow(lab.move())
    assert lab.arm.recover() == ""
    assert lab.arm.follow(lab.move()) == ""


def test_a_force_limit_above_the_reflex_is_refused(robot: Kinematics, limits: JointLimits) -> None:
    with pytest.raises(ParameterError, match="must trip before"):
        PandaArm(robot, limits, replace(PARAMS, force_limit=80.0))


def test_force_limits_leave_a_cup_of_30_mm_its_margin() -> None:
    """The trap: one 30 mm cup holds 42 N in theory; with a safety factor of 1.5, 28 N remain."""
    assert FlowStepParams().force_limit <= 42.4 / 1.5
    assert ProbeParams().force_limit < PandaParams().force_limit < PandaParams().collision_force


def test_an_arm_that_does_not_follow_is_a_fault(lab: Any) -> None:
    lab.robot.follows = False
    lab.arm.follow(lab.move(by=1.0))
    lab.feed(5.0)
    assert "off its target" in lab.arm.state().fault


def test_our_tip_is_not_the_hand_that_panda_python_assumes(robot: Kinematics) -> None:
    """The trap: panda_py.fk and ik are those of Franka's hand: flange, -45 degrees, 10.3 cm.

    With the pump they are wrong by centimetres; positions come from our description alone.
    """
    q = np.array(START)
    tip = robot.tip(q)
    hand = tip.position - tip.axis * (0.16 - 0.103)
    assert np.linalg.norm(tip.position - hand) == pytest.approx(0.057)
    # A wrong end effector in Desk moves what the robot says, and nothing of ours.
    lab_robot = MockRobot()
    lab_robot.tip[:3, 3] = hand
    assert not np.allclose(lab_robot.tip[:3, 3], tip.position, atol=0.05)


def test_a_missing_panda_python_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    """The trap: panda-python asks for numpy 2, which breaks Ubuntu's ROS: install it alone."""
    monkeypatch.setitem(sys.modules, "panda_py", None)
    with pytest.raises(BackendError, match="--no-deps"):
        load_panda_py()
    assert "websockets" in INSTALL


def test_closing_brakes_and_stops_the_controller_and_may_be_repeated(lab: Any) -> None:
    lab.arm.follow(lab.move(by=1.0))
    lab.feed(0.3)
    lab.arm.close()
    lab.arm.close()
    assert lab.robot.names().count("stop_controller") == 1
    assert not lab.arm.feed()


def test_the_feeding_thread_runs_and_ends(robot: Kinematics, limits: JointLimits) -> None:
    """In real time, as with a robot: the thread feeds, and nothing of it is left after closing."""
    bench = MockRobot()
    arm = PandaArm(robot, limits, PARAMS, library=MockLibrary(bench))
    arm.connect()
    goal = bench.q + 0.02
    assert (
        arm.follow(joint_move(robot.joint_names, JointState.at_rest(bench.q), goal, limits)) == ""
    )
    until(lambda: np.allclose(bench.q, goal), "the motion")
    bench.reflex("cartesian_reflex")
    until(lambda: bool(arm.state().fault), "the fault")
    assert arm.recover() == ""
    until(lambda: arm.state().fault == "", "the recovery")
    arm.close()
    assert "panda" not in [thread.name for thread in threading.enumerate()]


def until(condition: Callable[[], bool], what: str, seconds: float = 10.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"{what} did not come in {seconds} s"
        time.sleep(0.005)


def test_the_stand_in_has_the_shape_of_the_real_library() -> None:
    """Where panda-python is installed, every name that the backends use exists in it."""
    pytest.importorskip("panda_py", reason="panda-python is not installed")
    panda_py = load_panda_py()
    assert issubclass(panda_py.IncompatibleVersionError, RuntimeError)
    for name in (
        *("start_controller", "stop_controller", "recover", "create_context"),
        *("get_state", "refresh_state", "is_moving", "get_robot"),
    ):
        assert hasattr(panda_py.Panda, name)
    libfranka = panda_py.libfranka
    for name in (
        *("set_collision_behavior", "set_joint_impedance", "set_load"),
        *("read_once", "automatic_error_recovery"),
    ):
        assert hasattr(libfranka.Robot, name)
    assert libfranka.Duration(1500).to_sec() == 1.5
    fields = [
        "q",
        "dq",
        "O_F_ext_hat_K",
        "O_T_EE",
        "EE_T_K",
        "robot_mode",
        "current_errors",
        "time",
    ]
    assert all(hasattr(libfranka.RobotState, name) for name in fields)
    assert [mode.name for mode in RobotMode] == list(libfranka.RobotMode.__members__)
    assert str(libfranka.RobotMode.kReflex).rpartition(".")[2] == "kReflex"
    assert hasattr(libfranka.Errors, "cartesian_reflex")
    controller = panda_py.controllers.JointPosition(
        stiffness=np.array(PARAMS.stiffness), damping=np.array(PARAMS.damping)
    )
    controller.set_control(np.array(START), np.zeros(7))
    pump = ["vacuum", "in_control_range", "part_present", "part_detached", "device_status"]
    assert all(hasattr(libfranka.VacuumGripperState, name) for name in pump)
