"""One connection to a Panda through panda-python: which call may be made when."""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Sequence
from typing import Any

import numpy as np

from flowbothd_common.types import Array
from franka_suction_driver.backend_params import PandaParams
from franka_suction_driver.backends.library import (
    RAISED,
    LibraryError,
    calling,
    connection_problem,
)
from franka_suction_driver.backends.panda_reading import PandaReading, reading_of
from franka_suction_driver.backends.protocol import BackendError

_log = logging.getLogger(__name__)


class PandaLink:
    """A Panda object of panda-python 1.1, its controller and its error context.

    Facts about the library that this class lives by:

    - A control loop that died by itself still counts as running: until `stop_controller` is
      called, every read returns the last state before its death.
    - The second `stop_controller` reads the robot. The destructor calls it once more, where what a
      dead connection raises would end the process.
    - A target that is not finite raises in the control thread, where nobody can catch it.

    Args:
        library: The module panda_py or its stand-in.
        address: Of the control unit.

    Raises:
        BackendError: the robot cannot be reached; the remedy is in the message.
    """

    def __init__(self, library: Any, address: str) -> None:
        self._library = library
        try:
            self._panda = library.Panda(address)
        except RAISED as error:
            raise connection_problem(library, address, error) from error
        self._controller: Any = None
        self._context: Any = None
        self._stopped_once = False

    @property
    def running(self) -> bool:
        """Whether a controller runs and has to be fed."""
        return self._controller is not None

    def read(self) -> PandaReading:
        """Return the newest state; while a controller runs, the one that its loop saw last.

        Raises:
            LibraryError: the robot does not answer.
            UnusableStateError: its joint states are no usable numbers.
        """
        with calling("reading the robot's state"):
            seen = self._panda.get_state()
        return reading_of(seen)

    def set_thresholds(self, params: PandaParams) -> None:
        """Set the collision thresholds; the robot accepts them in mode kIdle only.

        The upper ones stop the robot; the lower ones, half of them, only flag a contact.

        Raises:
            LibraryError: it is in another mode, or does not answer.
        """
        torques = list(params.collision_torques)
        forces = [params.collision_force] * 6
        with calling("setting the collision thresholds"):
            self._panda.get_robot().set_collision_behavior(
                [0.5 * v for v in torques], torques, [0.5 * v for v in forces], forces
            )

    def clear_errors(self, errors: Sequence[str]) -> None:
        """Run the robot's automatic error recovery.

        Args:
            errors: Names of what is to be cleared, for the message of a failure.

        Raises:
            LibraryError: it is not possible in this mode, or the robot does not answer.
        """
        with calling(f"the automatic recovery from {' '.join(errors) or 'a reflex'}"):
            self._panda.recover()

    def start(self, q: Array, params: PandaParams) -> None:
        """Start the controller, holding at (7,) `q` [rad]; only for a robot without errors.

        Raises:
            LibraryError: the robot refuses at once; later refusals come from `turn`.
        """
        with calling("starting the controller"):
            controller = self._library.controllers.JointPosition(
                stiffness=np.array(params.stiffness), damping=np.array(params.damping)
            )
            context = self._panda.create_context(frequency=params.command_rate)
            context.__enter__()
            controller.set_control(q.copy(), np.zeros(len(q)))
            self._panda.start_controller(controller)
        self._controller, self._context = controller, context
        # The library has replaced the controller that was stopped before.
        self._stopped_once = False

    def turn(self) -> None:
        """Sleep until the next command is due.

        Raises:
            LibraryError: what the control loop has died of.
            BackendError: it has ended without an error.
        """
        context = self._context
        alive = False
        if context is not None:
            try:
                with calling("controlling the robot"):
                    alive = bool(context.ok())
            except LibraryError as error:
                self._loop_has_ended(lost=error.lost)
                raise
        if not alive:
            self._loop_has_ended(lost=False)
            raise BackendError("the control loop has ended", hint="call arm/recover")

    def command(self, position: Array, velocity: Array) -> None:
        """Give the controller its target, (7,) [rad] and (7,) [rad/s].

        Raises:
            BackendError: the target is not finite; the controller keeps the one before.
            LibraryError: the library refuses it.
        """
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
            raise BackendError(
                "the target of the arm is not finite",
                got=f"{np.round(position, 3).tolist()} rad",
                hint="this is a fault of this program: keep its log; then call arm/recover",
            )
        controller = self._controller
        if controller is not None:
            with calling("commanding the controller"):
                controller.set_control(position, velocity)

    def stop(self) -> None:
        """Stop the controller, if one runs.

        Raises:
            LibraryError: the robot does not answer; the controller is gone nevertheless.
        """
        if self._controller is None:
            return
        self._controller = self._context = None
        self._stopped_once = True
        with calling("stopping the controller"):
            self._panda.stop_controller()

    def discard(self) -> None:
        """Give up a connection that is dead."""
        self._controller = self._context = None
        panda, self._panda = self._panda, None
        if panda is not None and self._stopped_once:
            # Its destructor would read from the dead connection and end the process.
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(panda))

    def _loop_has_ended(self, *, lost: bool) -> None:
        """Make the library read afresh again; on a dead connection leave it as it is."""
        if lost:
            self._controller = self._context = None
            return
        try:
            self.stop()
        except LibraryError as error:
            _log.warning("%s", error)
