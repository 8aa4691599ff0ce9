"""Values of the library that are no numbers: never published, never believed, always said."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flowbothd_common.motion import JointState
from franka_suction_driver.backends.panda_link import PandaLink
from franka_suction_driver.backends.protocol import BackendError

NAN = float("nan")
BROKEN: dict[str, Any] = {
    "one NaN": [0.1, NAN, 0, 0, 0, 0, 0],
    "infinite": [0.1, 0, 0, 0, 0, 0, float("-inf")],
    "short": [0.1, 0, 0],
    "empty": [],
    "nothing": None,
}


@pytest.fixture
def lab(make_lab: Callable[..., Any]) -> Any:
    made = make_lab()
    made.arm.connect()
    return made


@pytest.mark.parametrize("field", ["q", "dq"])
@pytest.mark.parametrize("case", BROKEN)
def test_joint_states_that_are_no_numbers_brake_and_are_not_given(
    lab: Any, field: str, case: str
) -> None:
    """A NaN among the joint positions went out as a joint state and was below every limit."""
    trajectory = lab.move(by=1.0)
    lab.arm.follow(trajectory)
    lab.feed(0.5)
    good = lab.arm.state()
    lab.robot.reports[field] = BROKEN[case]
    lab.feed(0.1)
    state = lab.arm.state()
    assert np.isfinite(state.positions).all()
    assert np.isfinite(state.velocities).all()
    assert good.fresh
    assert not state.fresh
    assert f"{field} " in state.fault
    lab.feed(2.0)
    assert not lab.robot.dq.any(), "the arm has braked"
    assert lab.robot.q[0] < trajectory.positions[-1][0] - 0.05
    assert lab.arm.recover(), "it goes on as long as the values do"
    lab.robot.reports.clear()
    assert lab.arm.recover() == ""
    assert lab.arm.state().fresh


@pytest.mark.parametrize("field", ["O_F_ext_hat_K", "O_T_EE", "EE_T_K"])
@pytest.mark.parametrize("case", BROKEN)
def test_a_wrench_that_is_no_number_is_beyond_the_force_limit(
    lab: Any, field: str, case: str
) -> None:
    """`nan > limit` is false: with one NaN in the wrench no force limit held."""
    lab.arm.follow(lab.move(by=1.0))
    lab.feed(0.5)
    lab.robot.reports[field] = BROKEN[case]
    lab.feed(0.05)
    state = lab.arm.state()
    assert state.wrench is None
    assert state.fresh, "the joints are known"
    assert field in state.fault
    assert state.tip is None or np.isfinite(state.tip).all()
    assert field in lab.arm.tare()
    lab.feed(2.0)
    assert not lab.robot.dq.any(), "the arm has braked"
    lab.robot.reports.clear()
    assert lab.arm.recover() == ""


def test_a_robot_that_starts_with_broken_joint_states_is_not_taken_over(
    make_lab: Callable[..., Any],
) -> None:
    lab = make_lab()
    lab.robot.reports["q"] = [NAN] * 7
    with pytest.raises(BackendError, match="joint states that cannot be used"):
        lab.arm.connect()
    assert "start_controller" not in lab.robot.names()
    lab.robot.reports.clear()
    lab.arm.connect()
    assert lab.arm.state().fault == ""


def test_limits_fail_for_what_is_not_finite(lab: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both limits of the guard are written so that NaN is beyond them, wherever it comes from."""
    monkeypatch.setattr(lab.arm._wrench, "convert", lambda *_: np.full(6, NAN))
    lab.feed(0.01)
    assert "force limit" in lab.arm.state().fault


def test_a_target_that_is_no_number_never_reaches_the_controller(
    lab: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The trap: libfranka raises on it in the control thread, which ends the process."""
    nowhere = JointState(np.full(7, NAN), np.zeros(7), np.zeros(7))
    monkeypatch.setattr(lab.arm._commanded, "state", lambda _: nowhere)
    where = lab.robot.q.copy()
    assert not lab.arm.feed()
    assert lab.robot.crash == ""
    np.testing.assert_array_equal(lab.robot.q, where)
    assert "not finite" in lab.arm.state().fault


def test_the_link_refuses_a_target_that_is_not_finite(lab: Any) -> None:
    link = PandaLink(lab.library, "172.16.0.2")
    with pytest.raises(BackendError, match="not finite"):
        link.command(np.zeros(7), np.full(7, np.inf))


def test_a_trajectory_with_a_nan_is_refused_before_anything_is_commanded(lab: Any) -> None:
    good = lab.move()
    for name in ("times", "positions", "velocities", "accelerations"):
        values = getattr(good, name).copy()
        values.flat[3] = NAN
        assert lab.arm.follow(replace(good, **{name: values}))
    lab.feed(0.2)
    np.testing.assert_array_equal(lab.robot.dq, np.zeros(7))


@pytest.mark.parametrize(
    "error", [RuntimeError("?"), ValueError("?"), TypeError("?"), IndexError("?")]
)
def test_whatever_the_library_raises_is_a_fault(lab: Any, error: Exception) -> None:
    """Only RuntimeError was caught: pybind11 makes other Python errors of other C++ ones."""

    def fail() -> None:
        raise error

    lab.robot.on_call["get_state"] = fail
    lab.feed(0.05)
    assert "failed: ?" in lab.arm.state().fault
    assert lab.arm.recover() == ""
