"""A recording stand-in for panda-python with the real one's semantics, traps included.

It serves the tests and rehearsals without a robot (`backend: recording`). Everything that the
backends call is here, behaves as facts about the real library say, and is written to `calls`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from datetime import timedelta
from enum import Enum
from types import SimpleNamespace
from typing import Any

import numpy as np

from flowbothd_common.types import Array

START = (0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4)
ERRORS = ("cartesian_reflex", "joint_reflex", "communication_constraints_violation")
RobotMode = Enum(
    "RobotMode", "kOther kIdle kMove kGuiding kReflex kUserStopped kAutomaticErrorRecovery", start=0
)
DeviceStatus = Enum("DeviceStatus", "kGreen kYellow kOrange kRed", start=0)


class IncompatibleVersionError(RuntimeError):
    """The robot speaks another protocol; derives from RuntimeError as the real one does."""

    def __init__(self, message: str, libfranka_version: str) -> None:
        super().__init__(message)
        self.libfranka_version = libfranka_version


class RecordingRobot:
    """The robot and its pump behind the library, for tests to push and to look at.

    Attributes:
        calls: (name, arguments) of everything that was called.
        q: (7,) where the arm is; follows its targets exactly while `follows`.
        wrench: (6,) O_F_ext_hat_K: by the robot on the environment; zeros near a singularity.
        tip: (4, 4) O_T_EE, unless `fk` is set, which tells it from q.
        pump: State of the pump.
    """

    def __init__(self, q: Sequence[float] = START) -> None:
        self.calls: list[tuple[str, tuple[Any, ...]]] = []
        self.q: Array = np.array(q, dtype=float)
        self.dq: Array = np.zeros(7)
        self.wrench: Array = np.zeros(6)
        self.mode: Any = RobotMode.kIdle
        self.errors: set[str] = set()
        self.refusal: RuntimeError | None = None
        self.recovers = True
        self.follows = True
        self.tip: Array = np.eye(4)
        self.fk: Callable[[Array], Array] | None = None
        self.pump = PumpState()
        self.controller: Any = None
        self.pending: RuntimeError | None = None

    def note(self, name: str, *arguments: Any) -> None:
        """Write down a call."""
        self.calls.append((name, arguments))

    def names(self) -> list[str]:
        """Names of all calls, in order."""
        return [name for name, _ in self.calls]

    def reflex(self, error: str) -> None:
        """The robot stops itself; the control thread keeps the exception until it is asked."""
        self.mode, self.errors = RobotMode.kReflex, {error}
        self.controller = None
        self.pending = RuntimeError(f'libfranka: Move command aborted: ["{error}"]')

    def raise_pending(self) -> None:
        """Raise the stored error; only once."""
        error, self.pending = self.pending, None
        if error is not None:
            raise error

    def recover(self) -> None:
        """What Panda.recover and every start of a controller do; nothing on a user stop."""
        if self.mode is RobotMode.kUserStopped:
            return
        if self.errors or self.mode in (RobotMode.kReflex, RobotMode.kOther):
            self.note("automatic_error_recovery")
            if self.recovers:
                self.errors, self.mode = set(), RobotMode.kIdle


class PumpState:
    """The pump's physics: what seals the cup decides how far the vacuum goes.

    Attributes:
        sealed: Whether a part is at the cup.
        reachable: Vacuum that a sealed cup reaches [mbar].
        part_present_mbar: H2: above it a part counts as present.
        hold: While clear, `vacuum` blocks; None = it returns at once.
        lost: Raised by every call.
    """

    def __init__(self) -> None:
        self.sealed = False
        self.reachable = 750
        self.part_present_mbar = 550
        self.setpoint_mbar = 0
        self.held = False
        self.detached = False
        self.status: Any = DeviceStatus.kGreen
        self.hold: threading.Event | None = None
        self.lost: RuntimeError | None = None
        self.stuck = False

    def vacuum_mbar(self) -> int:
        """Vacuum at the cup now."""
        if self.stuck:
            return 300
        return min(self.setpoint_mbar, self.reachable) if self.sealed else 0

    def present(self) -> bool:
        """Whether the pump says that it holds a part."""
        return self.vacuum_mbar() > self.part_present_mbar


class RecordingLibrary:
    """Stands for the module panda_py with one robot behind it."""

    IncompatibleVersionError = IncompatibleVersionError

    def __init__(
        self,
        robot: RecordingRobot | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.robot = robot or RecordingRobot()
        robot = self.robot
        self.Panda = lambda hostname: _Panda(robot, hostname, sleep)
        self.controllers = SimpleNamespace(
            JointPosition=lambda stiffness, damping: _JointPosition(robot)
        )
        self.libfranka = SimpleNamespace(
            VacuumGripper=lambda address: _VacuumGripper(robot, address, clock),
            VacuumGripperProductionSetupProfile=SimpleNamespace(kP0=0, kP1=1, kP2=2, kP3=3),
            VacuumGripperDeviceStatus=DeviceStatus,
            RobotMode=RobotMode,
        )


class _JointPosition:
    def __init__(self, robot: RecordingRobot) -> None:
        self._robot = robot
        self.position: Array = robot.q.copy()
        self.velocity: Array = np.zeros(7)

    def set_control(self, position: Array, velocity: Array) -> None:
        self.position, self.velocity = np.array(position), np.array(velocity)
        robot = self._robot
        if robot.controller is self and robot.follows:
            robot.q, robot.dq = self.position, self.velocity


class _Context:
    def __init__(self, robot: RecordingRobot, period: float, sleep: Callable[[float], None]):
        self._robot, self._period, self._sleep = robot, period, sleep

    def __enter__(self) -> _Context:
        return self

    def ok(self) -> bool:
        self._sleep(self._period)
        self._robot.raise_pending()
        return self._robot.controller is not None


class _Panda:
    def __init__(self, robot: RecordingRobot, hostname: str, sleep: Callable[[float], None]):
        robot.note("Panda", hostname)
        if robot.refusal is not None:
            raise robot.refusal
        self._robot, self._sleep = robot, sleep
        self._cached = self._read()

    def _read(self) -> Any:
        robot = self._robot
        return SimpleNamespace(
            q=robot.q.tolist(),
            dq=robot.dq.tolist(),
            O_F_ext_hat_K=robot.wrench.tolist(),
            O_T_EE=(robot.tip if robot.fk is None else robot.fk(robot.q)).T.ravel().tolist(),
            EE_T_K=np.eye(4).ravel().tolist(),
            robot_mode=robot.mode,
            current_errors=SimpleNamespace(**{n: n in robot.errors for n in ERRORS}),
        )

    def get_state(self) -> Any:
        # A running controller refreshes the copy; without one it is as old as the last refresh.
        if self._robot.controller is not None:
            self._cached = self._read()
        return self._cached

    def refresh_state(self) -> None:
        self._cached = self._read()

    def get_robot(self) -> Any:
        return SimpleNamespace(
            set_collision_behavior=lambda *a: self._robot.note("set_collision_behavior", *a)
        )

    def start_controller(self, controller: _JointPosition) -> None:
        self._robot.recover()
        self._robot.note("start_controller")
        if self._robot.mode is RobotMode.kUserStopped:
            raise RuntimeError("libfranka: command rejected: user stop")
        self._robot.mode, self._robot.controller = RobotMode.kMove, controller

    def stop_controller(self) -> None:
        self._robot.note("stop_controller")
        self._robot.controller = None
        if self._robot.mode is RobotMode.kMove:
            self._robot.mode = RobotMode.kIdle

    def recover(self) -> None:
        self._robot.note("recover")
        self._robot.recover()

    def create_context(self, frequency: float) -> _Context:
        return _Context(self._robot, 1.0 / frequency, self._sleep)


class _VacuumGripper:
    """Its calls block as the real ones do; the set-point is in 10 mbar, the state in mbar."""

    def __init__(self, robot: RecordingRobot, address: str, clock: Callable[[], float]) -> None:
        robot.note("VacuumGripper", address)
        if robot.refusal is not None:
            raise robot.refusal
        self._robot, self._clock = robot, clock

    def vacuum(self, vacuum: int, timeout: timedelta, profile: int = 0) -> bool:
        pump = self._pump("vacuum", vacuum, timeout, profile)
        if not isinstance(vacuum, int) or not 0 <= vacuum <= 255:
            raise TypeError("vacuum(): incompatible function arguments: uint8 is needed")
        pump.setpoint_mbar = 10 * vacuum
        pump.detached = False
        if pump.hold is not None:
            pump.hold.wait(timeout.total_seconds())
        return pump.present()

    def drop_off(self, timeout: timedelta) -> bool:
        pump = self._pump("drop_off", timeout)
        pump.setpoint_mbar = 0
        return not pump.stuck

    def stop(self) -> bool:
        pump = self._pump("stop")
        pump.setpoint_mbar = 0
        return True

    def read_once(self) -> Any:
        pump = self._pump()
        present = pump.present()
        pump.detached = pump.detached or (pump.held and not present and pump.setpoint_mbar > 0)
        pump.held = present
        level = pump.vacuum_mbar()
        return SimpleNamespace(
            vacuum=level,
            in_control_range=bool(pump.setpoint_mbar) and level >= pump.setpoint_mbar,
            part_present=present,
            part_detached=pump.detached,
            device_status=pump.status,
            actual_power=50,
        )

    def _pump(self, name: str = "", *arguments: Any) -> PumpState:
        if name:
            self._robot.note(name, *arguments)
        if self._robot.pump.lost is not None:
            raise self._robot.pump.lost
        return self._robot.pump
