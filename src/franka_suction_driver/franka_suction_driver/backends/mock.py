"""Mock of panda-python with the real one's semantics, traps included.

It serves the tests and rehearsals without a robot (`backend: mock`). Everything that the
backends call is here, behaves as facts about the real library say, and is written to `calls`;
reads and targets are not, since they come hundreds of times a second.
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
from franka_suction_driver.backends.mock_modes import (
    NO_ANSWER,
    TCP_LOST,
    UDP_LOST,
    RobotMode,
)
from franka_suction_driver.backends.mock_panda import JointPosition, Panda

START = (0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4)
"""Joint positions at power-on [rad]: the robot's usual ready pose."""
DeviceStatus = Enum("DeviceStatus", "kGreen kYellow kOrange kRed", start=0)


class IncompatibleVersionError(RuntimeError):
    """The robot speaks another protocol; derives from RuntimeError as the real one does."""

    def __init__(self, message: str, libfranka_version: str) -> None:
        super().__init__(message)
        self.libfranka_version = libfranka_version


class MockRobot:
    """The robot and its pump behind the library, for tests to push and to look at.

    Attributes:
        calls: (name, arguments) of everything that was called.
        q: (7,) where the arm is; follows its targets exactly while `follows`.
        wrench: (6,) O_F_ext_hat_K: by the robot on the environment; zeros near a singularity.
        tip: (4, 4) O_T_EE, unless `fk` is set, which tells it from q.
        reports: Fields of the state that are reported instead of the true ones.
        recovers: The automatic recovery succeeds; otherwise it asks for a manual one.
        refusal: Raised to whoever connects.
        on_call: Name of a call -> what happens, once, when it is made next.
        stopped_at: Speed at which the controller was stopped last [rad/s].
        crash: What would have ended the process without a Python exception; empty if nothing.
        clock: Steady time [s]; the library's.
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
        self.reports: dict[str, Any] = {}
        self.pump = PumpState()
        self.controller: Any = None
        self.pending: RuntimeError | None = None
        self.clock: Callable[[], float] = time.monotonic
        self.plugged = True
        self.session = 0
        self.unplugged_at = 0.0
        self.loss_raised = False
        self.on_call: dict[str, Callable[[], None]] = {}
        self.stopped_at = 0.0
        self.crash = ""

    def note(self, name: str, *arguments: Any) -> None:
        """Write down a call."""
        self.calls.append((name, arguments))

    def names(self) -> list[str]:
        """Names of all calls, in order."""
        return [name for name, _ in self.calls]

    def arrive(self, name: str) -> None:
        """Let a call begin; something may happen to the robot at this very moment."""
        happens = self.on_call.pop(name, None)
        if happens is not None:
            happens()

    def reflex(self, error: str) -> None:
        """Stop by a reflex; the control thread keeps the exception until it is asked."""
        moved = self.controller is not None
        self.mode, self.errors = RobotMode.kReflex, {error}
        self._halt()
        if moved:
            self.pending = RuntimeError(
                f'libfranka: Move command aborted: motion aborted by reflex! ["{error}"]'
            )

    def press_user_stop(self) -> None:
        """Stop by the button; no command and no recovery ends this."""
        moved = self.controller is not None
        self.mode = RobotMode.kUserStopped
        self._halt()
        if moved:
            self.pending = RuntimeError("libfranka: Move command aborted: User Stop pressed!")

    def unplug(self) -> None:
        """Pull the cable: connections die, and a robot that was moved stops by a reflex."""
        self.plugged, self.session = False, self.session + 1
        self.unplugged_at, self.loss_raised, self.pending = self.clock(), False, None
        if self.controller is not None:
            self.mode, self.errors = RobotMode.kReflex, {"communication_constraints_violation"}
        self._halt()

    def plug_in(self) -> None:
        """Put the cable back: new connections are possible, old ones stay dead."""
        self.plugged = True

    def raise_pending(self) -> None:
        """Raise the stored error; only once."""
        error, self.pending = self.pending, None
        if error is not None:
            raise error

    def _halt(self) -> None:
        self.controller = None
        self.dq = np.zeros(7)


class PumpState:
    """The pump's physics: what seals the cup decides how far the vacuum goes.

    Attributes:
        sealed: Whether a part is at the cup.
        reachable: Vacuum that a sealed cup reaches [mbar].
        part_present_mbar: H2: above it a part counts as present.
        hold: While clear, `vacuum` blocks; None = it returns at once.
        lost: Raised by every call.
        reported: Vacuum that is reported instead of the true one [mbar].
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
        self.reported: Any = None

    def vacuum_mbar(self) -> int:
        """Vacuum at the cup now."""
        if self.stuck:
            return 300
        return min(self.setpoint_mbar, self.reachable) if self.sealed else 0

    def present(self) -> bool:
        """Whether the pump says that it holds a part."""
        return self.vacuum_mbar() > self.part_present_mbar


class MockLibrary:
    """Stands for the module panda_py with one robot behind it."""

    IncompatibleVersionError = IncompatibleVersionError

    def __init__(
        self,
        robot: MockRobot | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.robot = robot or MockRobot()
        robot = self.robot
        robot.clock = clock
        self.Panda = lambda hostname: Panda(robot, hostname, sleep)
        self.controllers = SimpleNamespace(
            JointPosition=lambda stiffness, damping: JointPosition(robot)
        )
        self.libfranka = SimpleNamespace(
            VacuumGripper=lambda address: _VacuumGripper(robot, address, clock),
            VacuumGripperProductionSetupProfile=SimpleNamespace(kP0=0, kP1=1, kP2=2, kP3=3),
            VacuumGripperDeviceStatus=DeviceStatus,
            RobotMode=RobotMode,
        )


class _VacuumGripper:
    """Its calls block as the real ones do; the set-point is in 10 mbar, the state in mbar."""

    def __init__(self, robot: MockRobot, address: str, clock: Callable[[], float]) -> None:
        robot.note("VacuumGripper", address)
        if robot.refusal is not None:
            raise robot.refusal
        if not robot.plugged:
            raise RuntimeError(NO_ANSWER)
        self._robot, self._clock, self._session = robot, clock, robot.session

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
            vacuum=level if pump.reported is None else pump.reported,
            in_control_range=bool(pump.setpoint_mbar) and level >= pump.setpoint_mbar,
            part_present=present,
            part_detached=pump.detached,
            device_status=pump.status,
            actual_power=50,
        )

    def _pump(self, name: str = "", *arguments: Any) -> PumpState:
        if name:
            self._robot.note(name, *arguments)
        if not self._robot.plugged or self._session != self._robot.session:
            raise RuntimeError(TCP_LOST if name else UDP_LOST)
        if self._robot.pump.lost is not None:
            raise self._robot.pump.lost
        return self._robot.pump
