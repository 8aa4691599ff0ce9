"""Schmalz Cobot Pump through libfranka's VacuumGripper."""

from __future__ import annotations

import logging
import math
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from typing import Any

from flowbothd_common.errors import SuctionError
from flowbothd_common.types import SuctionReading
from franka_suction_driver.backend_params import PumpNodeParams
from franka_suction_driver.backends.library import (
    RAISED,
    connection_problem,
    is_lost,
    load_panda_py,
)
from franka_suction_driver.backends.protocol import BackendError

_log = logging.getLogger(__name__)
_PASCAL_PER_MBAR = 100.0
"""The pump measures in millibar."""
_PASCAL_PER_SETPOINT = 1000.0
"""One step of the pump's set-point, 10 mbar [Pa]."""
_LARGEST_SETPOINT = 255
"""The set-point is one byte."""
# Pause before a connection that was lost is tried again [s]: a try may block for long.
_RECONNECT = 5.0


def setpoint(vacuum: float, part_present_vacuum: float) -> int:
    """Return the gripper's set-point, in 10 mbar, for a vacuum in pascal.

    Raises:
        SuctionError: the pump has no such set-point, or would never report a part at it.
    """
    value = round(vacuum / _PASCAL_PER_SETPOINT) if math.isfinite(vacuum) else 0
    if not 1 <= value <= _LARGEST_SETPOINT:
        raise SuctionError(
            "vacuum set-point of the Cobot Pump",
            got=f"{vacuum:g} Pa",
            allowed=f"{_PASCAL_PER_SETPOINT:g} .. {_LARGEST_SETPOINT * _PASCAL_PER_SETPOINT:g} Pa",
            hint="the unit is pascal: 600 mbar are 60000 Pa",
        )
    if value * _PASCAL_PER_SETPOINT <= part_present_vacuum:
        raise SuctionError(
            "the set-point lies below the pump's part-present threshold: no part would ever count "
            "as held",
            got=f"{vacuum:g} Pa",
            allowed=f"more than {part_present_vacuum:g} Pa (H2 of the pump's profile)",
            hint="raise the set-point, or lower H2 in the pump and part_present_vacuum with it",
        )
    return value


class CobotPump:
    """PumpBackend over panda_py.libfranka.VacuumGripper.

    Building up and releasing vacuum block for seconds, so they run in a thread of their own.
    Reading the state holds Python's interpreter lock until the next packet comes: let this class
    have a process of its own, as pump_node has.

    Args:
        params: Address, timeouts, thresholds.
        library: Stands for the module panda_py; loaded when connecting if omitted.
        clock: Steady time [s].
    """

    def __init__(
        self,
        params: PumpNodeParams,
        *,
        library: Any = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._params, self._library, self._clock = params, library, clock
        self._gripper: Any = None
        # None where nobody knows what the pump does, so that any command is passed on.
        self._setpoint: int | None = 0
        self._commands: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        self._reading: SuctionReading | None = None
        self._trouble = ""
        self._silent = False
        self._heard = clock()
        self._retry_at = 0.0
        self._closing = threading.Event()
        self._threads: list[threading.Thread] = []

    def connect(self) -> None:
        """Reach the pump and begin to read it."""
        if self._library is None:
            self._library = load_panda_py()
        address = self._params.robot_ip
        if not address:
            raise BackendError("no robot address", hint="set robot_ip, or `up robot --robot`")
        self._gripper = self._open()
        for name, work in (("pump_commands", self._obey), ("pump_state", self._poll)):
            self._threads.append(threading.Thread(target=work, name=name, daemon=True))
            self._threads[-1].start()

    def command(self, vacuum: float) -> None:
        """Hold `vacuum` [Pa] or, with 0, release; repeating a command only shows a live sender."""
        # A vacuum that is not a number is refused, not taken for a release.
        released = -math.inf < vacuum <= 0
        value = 0 if released else setpoint(vacuum, self._params.part_present_vacuum)
        self._heard, self._silent = self._clock(), False
        if value != self._setpoint:
            self._setpoint = value
            self._commands.put(value)

    def reading(self) -> SuctionReading | None:
        """Newest measurement, with what is wrong as its fault."""
        if self._setpoint and self._clock() - self._heard > self._params.command_timeout:
            self._setpoint = 0
            self._commands.put(0)
            self._silent = True
        if self._silent and self._reading is not None:
            return replace(self._reading, fault="suction/command fell silent: released the part")
        return self._reading

    def close(self) -> None:
        """Release, switch off, end the threads; whatever goes wrong on the way is logged."""
        self._closing.set()
        self._commands.put(None)
        for thread in self._threads:
            thread.join(timeout=self._params.vacuum_timeout + 1.0)
        self._threads.clear()
        gripper, self._gripper = self._gripper, None
        if gripper is not None:
            self._release(gripper)

    def _open(self) -> Any:
        address = self._params.robot_ip
        try:
            return self._library.libfranka.VacuumGripper(address)
        except RAISED as error:
            problem = connection_problem(self._library, address, error)
            hint = f"{problem.hint}; Desk, Settings, End-Effector must say Cobot Pump"
            raise BackendError(problem.what, hint=hint) from error

    def _obey(self) -> None:
        """Run commands one after the other; only the newest of those that wait counts."""
        while (value := self._commands.get()) is not None:
            while not self._commands.empty():
                newer = self._commands.get()
                if newer is None:
                    return
                value = newer
            if value:
                self._build_up(value)
            else:
                self._release(self._gripper)

    def _build_up(self, value: int) -> None:
        params = self._params
        profiles = self._library.libfranka.VacuumGripperProductionSetupProfile
        try:
            reached = self._gripper.vacuum(
                value,
                timedelta(seconds=params.vacuum_timeout),
                getattr(profiles, f"kP{params.profile}"),
            )
        except RAISED as error:
            self._trouble = f"the pump does not build up vacuum: {error}"
            return
        self._trouble = ""
        # Not an error: the cup may not touch anything yet. What comes of it is polled.
        _log.info("vacuum %s within %g s", "up" if reached else "not up", params.vacuum_timeout)

    def _release(self, gripper: Any) -> None:
        """Vent, check that the part is off, and end the command in any case."""
        try:
            gripper.drop_off(timedelta(seconds=self._params.drop_off_timeout))
            left = gripper.read_once()
            level = _PASCAL_PER_MBAR * float(left.vacuum)
            # Written so that a level that is not finite counts as not released.
            if not left.part_present and level <= self._params.released_vacuum:
                self._trouble = ""
            else:
                self._trouble = f"the part is not released: {level:.0f} Pa are left at the cup"
        except RAISED as error:
            self._trouble = f"the pump does not release: {error}"
            _log.error("%s", self._trouble)
        finally:
            try:
                gripper.stop()
            except RAISED as error:
                _log.error("the pump does not stop: %s", error)

    def _poll(self) -> None:
        while not self._closing.wait(1.0 / self._params.poll_rate):
            try:
                self._reading = self._read(self._gripper)
            except RAISED as error:
                self._reading = SuctionReading(fault=f"the pump does not answer: {error}")
                if is_lost(error):
                    self._reconnect()

    def _reconnect(self) -> None:
        """Replace a connection that is dead; what is commanded next is then commanded anyway."""
        if self._clock() < self._retry_at:
            return
        self._retry_at = self._clock() + _RECONNECT
        try:
            self._gripper = self._open()
        except BackendError as error:
            _log.warning("%s", error)
            return
        self._setpoint = None
        _log.info("the pump is connected again")

    def _read(self, gripper: Any) -> SuctionReading:
        state = gripper.read_once()
        vacuum = _PASCAL_PER_MBAR * float(state.vacuum)
        if not math.isfinite(vacuum):
            return SuctionReading(
                fault=f"the pump reports a vacuum of {state.vacuum} mbar, which is no measurement: "
                "restart the pump"
            )
        red = str(state.device_status).endswith("kRed")
        return SuctionReading(
            vacuum,
            bool(state.part_present),
            bool(state.part_detached),
            "the pump reports a device error (red): see its display" if red else self._trouble,
            bool(state.in_control_range),
        )
