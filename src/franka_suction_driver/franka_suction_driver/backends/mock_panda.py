"""The stand-in's Panda object, with what panda-python 1.1.1 and libfranka 0.9.2 raise, and when.

Every object belongs to one connection: after a pulled cable it stays dead, plugged in or not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from flowbothd_common.types import Array
from franka_suction_driver.backends.mock_modes import (
    ERRORS,
    NO_ANSWER,
    TCP_LOST,
    UDP_LOST,
    UDP_TIMEOUT,
    RobotMode,
    rejection,
)

if TYPE_CHECKING:
    from franka_suction_driver.backends.mock import MockRobot


class JointPosition:
    """The controller: holds the newest target; the robot follows it while the loop runs."""

    def __init__(self, robot: MockRobot) -> None:
        self._robot = robot
        self.running = False
        self.position: Array = robot.q.copy()
        self.velocity: Array = np.zeros(7)

    def set_control(self, position: Array, velocity: Array) -> None:
        """Take a target; one that is not finite raises in the control thread: the process ends."""
        self.position, self.velocity = np.array(position), np.array(velocity)
        robot = self._robot
        if not (np.isfinite(self.position).all() and np.isfinite(self.velocity).all()):
            robot.crash = "a target that is not finite raised in the control thread"
        elif robot.controller is self and robot.follows:
            robot.q, robot.dq = self.position, self.velocity


class Context:
    """Paces the feeding loop and raises, once, what the control thread has stored."""

    def __init__(self, panda: Panda, period: float, sleep: Callable[[float], None]) -> None:
        self._panda, self._period, self._sleep = panda, period, sleep

    def __enter__(self) -> Context:
        return self

    def ok(self) -> bool:
        """Sleep until the next turn; a loop that is dead without an error is not noticed here."""
        self._panda.raise_error()
        self._sleep(self._period)
        return True


class Robot:
    """The libfranka robot of a Panda: settings are accepted in mode kIdle and refused elsewhere."""

    def __init__(self, panda: Panda) -> None:
        self._panda = panda

    def set_collision_behavior(self, *thresholds: Sequence[float]) -> None:
        """Set the thresholds."""
        self._set("Set Collision Behavior", "set_collision_behavior", *thresholds)

    def set_joint_impedance(self, stiffness: Sequence[float]) -> None:
        """Set the stiffness of libfranka's own joint controller."""
        self._set("Set Joint Impedance", "set_joint_impedance", stiffness)

    def set_load(self, mass: float, centre: Sequence[float], inertia: Sequence[float]) -> None:
        """Set the load."""
        self._set("Set Load", "set_load", mass, centre, inertia)

    def read_once(self) -> Any:
        """Read a state; not while a control loop runs."""
        return self._panda.read("read_once")

    def automatic_error_recovery(self) -> None:
        """Clear errors; only a human can end a user stop, guiding and locked joints."""
        robot = self._panda.connected("automatic_error_recovery", TCP_LOST)
        robot.note("automatic_error_recovery")
        command = "Automatic Error Recovery"
        if robot.mode is RobotMode.kUserStopped:
            raise RuntimeError(f"libfranka: {command} command aborted: User Stop pressed!")
        if robot.mode in (RobotMode.kGuiding, RobotMode.kMove, RobotMode.kOther):
            raise rejection(command, robot.mode)
        if not robot.recovers:
            raise RuntimeError(
                f"libfranka: {command} command rejected: manual error recovery required!"
            )
        robot.errors, robot.mode = set(), RobotMode.kIdle

    def _set(self, command: str, name: str, *arguments: Any) -> None:
        robot = self._panda.connected(name, TCP_LOST)
        robot.note(name, *arguments)
        if robot.mode is not RobotMode.kIdle:
            raise rejection(command, robot.mode)


class Panda:
    """Stands for panda_py.Panda on one connection."""

    def __init__(self, robot: MockRobot, hostname: str, sleep: Callable[[float], None]):
        self._robot, self._sleep = robot, sleep
        self._session = -1
        self._controller: JointPosition | None = None
        self._stopped_before = False
        robot.arrive("Panda")
        robot.note("Panda", hostname)
        if robot.refusal is not None:
            raise robot.refusal
        if not robot.plugged:
            raise RuntimeError(NO_ANSWER)
        self._session = robot.session
        self._cached = self.read("read_once")

    def __del__(self) -> None:
        if self._stopped_before and not self._alive():
            self._robot.crash = "the destructor of Panda read from a dead connection"

    def get_state(self) -> Any:
        """Return the last state; read first, unless a controller counts as running."""
        self._robot.arrive("get_state")
        self.refresh_state()
        return self._cached

    def refresh_state(self) -> None:
        """Read the robot; a no-op while a controller counts as running, also one that is dead."""
        if not self.is_moving():
            self._cached = self.read("read_once")
        elif self._loop_lives():
            self._cached = self._snapshot()

    def is_moving(self) -> bool:
        """Return whether a controller was started and not stopped: not whether its loop lives."""
        return self._controller is not None and self._controller.running

    def get_robot(self) -> Robot:
        """Return the libfranka robot."""
        return Robot(self)

    def start_controller(self, controller: JointPosition) -> None:
        """Start; a refusal of the robot is stored by the control thread, not raised here."""
        self._stop()
        self._recover()
        robot = self.connected("start_controller", UDP_LOST)
        robot.note("start_controller")
        self._controller, controller.running, self._stopped_before = controller, True, False
        if robot.mode is not RobotMode.kIdle:
            robot.pending = rejection("Move", robot.mode)
            return
        robot.mode, robot.controller = RobotMode.kMove, controller

    def stop_controller(self) -> None:
        """End the controller; a second call reads the robot first, and raises if it cannot."""
        self._robot.arrive("stop_controller")
        self._robot.note("stop_controller")
        self._stop()

    def _stop(self) -> None:
        robot = self._robot
        if self._controller is None:
            return
        self.refresh_state()
        self._stopped_before = True
        ours, self._controller.running = robot.controller is self._controller, False
        if ours and self._alive():
            robot.stopped_at = float(np.abs(robot.dq).max())
            robot.controller, robot.dq = None, np.zeros(7)
            if robot.mode is RobotMode.kMove:
                robot.mode = RobotMode.kIdle

    def recover(self) -> None:
        """Recover automatically from errors, kReflex and kOther; do nothing on a user stop."""
        self._robot.note("recover")
        self._recover()

    def _recover(self) -> None:
        self.read("recover")
        robot = self._robot
        if robot.errors or robot.mode in (RobotMode.kReflex, RobotMode.kOther):
            self.get_robot().automatic_error_recovery()

    def create_context(self, frequency: float) -> Context:
        """Return a context for a loop at `frequency` [Hz]."""
        return Context(self, 1.0 / frequency, self._sleep)

    def raise_error(self) -> None:
        """Raise what the control thread has stored; only once."""
        robot = self._robot
        robot.arrive("ok")
        lost = self._session != robot.session or not robot.plugged
        if lost and self.is_moving() and robot.pending is None and not robot.loss_raised:
            # The control thread waits so long for a state before it gives up.
            if robot.clock() - robot.unplugged_at < UDP_TIMEOUT:
                return
            robot.loss_raised = True
            robot.pending = RuntimeError(UDP_LOST)
        robot.raise_pending()

    def read(self, name: str) -> Any:
        """Read the robot over UDP."""
        self.connected(name, UDP_LOST)
        return self._snapshot()

    def connected(self, name: str, lost: str) -> MockRobot:
        """Return the robot, or raise as libfranka does on a dead connection."""
        robot = self._robot
        robot.arrive(name)
        if not self._alive():
            if lost is UDP_LOST:
                self._sleep(UDP_TIMEOUT)
            raise RuntimeError(lost)
        return robot

    def _alive(self) -> bool:
        return self._robot.plugged and self._session == self._robot.session

    def _loop_lives(self) -> bool:
        return self._alive() and self._robot.controller is self._controller

    def _snapshot(self) -> Any:
        robot = self._robot
        now = robot.clock()
        values = {
            "q": np.asarray(robot.q).tolist(),
            "dq": np.asarray(robot.dq).tolist(),
            "O_F_ext_hat_K": np.asarray(robot.wrench).tolist(),
            "O_T_EE": (robot.tip if robot.fk is None else robot.fk(robot.q)).T.ravel().tolist(),
            "EE_T_K": np.eye(4).ravel().tolist(),
            "robot_mode": robot.mode,
            "current_errors": SimpleNamespace(**{n: n in robot.errors for n in ERRORS}),
            "time": SimpleNamespace(to_sec=lambda: now),
        }
        return SimpleNamespace(**(values | robot.reports))
