"""Panda (FER) through panda-python: a 1 kHz C++ controller fed from our trajectories."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from flowbothd_common.errors import ParameterError
from flowbothd_common.motion import JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.arm.commander import Commander
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.arm.stopping import joint_stop
from franka_suction_driver.backend_params import PandaParams
from franka_suction_driver.backends.acceptance import objection
from franka_suction_driver.backends.library import (
    connection_problem,
    explained,
    load_panda_py,
    named_errors,
)
from franka_suction_driver.backends.protocol import ArmState, BackendError
from franka_suction_driver.backends.wrench import ExternalWrench

_log = logging.getLogger(__name__)
USER_STOP = "the user stop is pressed: release it, then call arm/recover"
_POLL = 0.05


class PandaArm:
    """ArmBackend over panda-python.

    Python only writes targets; the torque loop runs in panda-python's own thread. That thread
    stores its errors until somebody asks, so the feeding loop asks at every turn and latches what
    it hears. panda-python recovers by itself whenever a controller is started: this class starts
    one only on a robot without errors, and after `recover` was asked for.

    Args:
        kinematics: The arm with our tip; not shared with another thread.
        limits: What no trajectory may exceed.
        params: Address, gains, thresholds.
        library: Stands for the module panda_py; loaded when connecting if omitted.
        clock: Steady time [s].
        sleep: Waits so many seconds on that clock.
        threaded: Feed the controller from a thread; otherwise call `feed` yourself.
        start_tolerance: How far beside its commanded state a trajectory may begin [rad].

    Raises:
        ParameterError: our force limit would not trip before libfranka's.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        limits: JointLimits,
        params: PandaParams,
        *,
        library: Any = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        threaded: bool = True,
        start_tolerance: float = 0.03,
    ) -> None:
        if params.force_limit >= params.collision_force:
            raise ParameterError(
                "panda.force_limit must trip before libfranka's reflex",
                got=f"{params.force_limit:g} N",
                allowed=f"less than panda.collision_force, {params.collision_force:g} N",
            )
        self._kinematics, self._limits, self._params = kinematics, limits, params
        self._library, self._threaded = library, threaded
        self._start_tolerance = start_tolerance
        self._clock, self._sleep = clock, sleep
        self._wrench = ExternalWrench(kinematics, params.least_conditioning)
        self._lock = threading.RLock()
        self._commander = Commander()
        self._panda: Any = None
        self._controller: Any = None
        self._context: Any = None
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()
        self._fault = ""
        self._state: ArmState | None = None

    def connect(self) -> None:
        """Reach the robot, set thresholds, and hold it where it stands."""
        if self._library is None:
            self._library = load_panda_py()
        if not self._params.robot_ip:
            raise BackendError("no robot address", hint="set panda.robot_ip, or `up real --robot`")
        address = self._params.robot_ip
        try:
            panda = self._library.Panda(address)
            self._set_thresholds(panda)
        except RuntimeError as error:
            raise connection_problem(self._library, address, error) from error
        with self._lock:
            self._panda = panda
            self._fault = self._problem(panda.get_state())
            if not self._fault:
                self._start()

    def state(self) -> ArmState | None:
        """Newest state; read from the robot where the feeding loop does not run."""
        with self._lock:
            if self._panda is None:
                return None
            if self._controller is None:
                # Without a controller nothing refreshes panda-python's copy of the state.
                try:
                    self._panda.refresh_state()
                except RuntimeError as error:
                    self._fault = self._fault or explained(str(error))
                self._measure()
            return self._state

    def follow(self, trajectory: JointTrajectory) -> str:
        """Take over a trajectory from the state that is commanded now."""
        with self._lock:
            if self._fault:
                return self._fault
            if self._controller is None:
                return "the robot is not connected"
            now = self._clock()
            commanded = self._commander.state(now)
            reason = objection(trajectory, self._limits, commanded, self._start_tolerance)
            if reason:
                self.hold()
            else:
                self._commander.issue(trajectory, now)
            return reason

    def hold(self) -> None:
        """Brake all joints within their limits."""
        with self._lock:
            if self._controller is None:
                return
            now = self._clock()
            commanded = self._commander.state(now)
            if commanded.velocity.any():
                names = self._kinematics.joint_names
                self._commander.issue(joint_stop(names, commanded, self._limits), now)

    def recover(self) -> str:
        """Run libfranka's error recovery, then hold where the arm stands."""
        self._end_feeding()
        with self._lock:
            if self._panda is None:
                return "the robot is not connected"
            self._panda.refresh_state()
            if self._mode(self._panda.get_state()) == "kUserStopped":
                self._fault = USER_STOP
                return self._fault
            try:
                self._panda.recover()
            except RuntimeError as error:
                self._fault = explained(str(error))
                return self._fault
            self._fault = self._await_health()
            if not self._fault:
                _log.info("recovered on request")
                self._start()
            return self._fault

    def tare(self) -> str:
        """Take the present wrench for zero."""
        with self._lock:
            if self._panda is None:
                return "the robot is not connected"
            if not self._wrench.tare(*self._raw_wrench(self._panda.get_state())):
                return "no wrench is measured here: the arm is near a singularity"
            return ""

    def close(self) -> None:
        """Brake, stop the controller, end the thread."""
        self.hold()
        self._end_feeding()
        with self._lock:
            self._panda = None

    def feed(self) -> bool:
        """One turn of the feeding loop; whether there is to be another."""
        context, controller = self._context, self._controller
        if context is None or controller is None or self._closing.is_set():
            return False
        try:
            # Sleeps until the next turn, and raises what the control thread has run into.
            if not context.ok():
                self._latch("the control loop has ended")
                return False
            with self._lock:
                target = self._commander.state(self._clock())
                controller.set_control(target.position, target.velocity)
                self._measure()
                self._guard(target.position)
        except RuntimeError as error:
            self._latch(str(error))
            return False
        return True

    def _start(self) -> None:
        """Start the controller at the measured position; only for a robot without errors."""
        state = self._panda.get_state()
        self._commander.reset(np.array(state.q))
        params = self._params
        self._controller = self._library.controllers.JointPosition(
            stiffness=np.array(params.stiffness), damping=np.array(params.damping)
        )
        self._controller.set_control(np.array(state.q), np.zeros(len(state.q)))
        self._panda.start_controller(self._controller)
        self._context = self._panda.create_context(frequency=params.command_rate)
        self._context.__enter__()
        self._closing.clear()
        self._measure()
        if self._threaded:
            self._thread = threading.Thread(target=self._run, name="panda", daemon=True)
            self._thread.start()

    def _run(self) -> None:
        while self.feed():
            pass

    def _end_feeding(self) -> None:
        """Stop the controller; not to be called with the lock held, which the loop needs to end."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(timeout=1.0)
        with self._lock:
            self._thread = None
            controller, self._controller, self._context = self._controller, None, None
            if controller is None or self._panda is None:
                return
            try:
                self._panda.stop_controller()
            except RuntimeError as error:
                _log.warning("stopping the controller: %s", error)

    def _latch(self, text: str) -> None:
        with self._lock:
            errors = named_errors(self._panda.get_state().current_errors) if self._panda else []
            self._fault = self._fault or explained(", ".join([text, *errors]))
            self._controller = self._context = None
            self._measure()
        _log.error("the arm has stopped: %s", self._fault)

    def _guard(self, target: Array) -> None:
        """Brake and latch on too much force, or on an arm that does not follow."""
        state = self._state
        if state is None or self._fault:
            return
        force = 0.0 if state.wrench is None else float(np.linalg.norm(state.wrench[:3]))
        lag = float(np.abs(state.positions - target).max())
        if force > self._params.force_limit:
            what = f"force limit: {force:.0f} N (panda.force_limit {self._params.force_limit:g} N)"
        elif lag > self._params.lag_limit:
            what = f"the arm is {lag:.2f} rad off its target (panda.lag_limit)"
        else:
            return
        self.hold()
        self._fault = explained(what)
        _log.error("the arm brakes: %s", self._fault)
        self._measure()

    def _measure(self) -> None:
        seen = self._panda.get_state()
        raw, q, origin = self._raw_wrench(seen)
        if not self._fault:
            self._fault = self._problem(seen)
        tip = np.array(seen.O_T_EE).reshape(4, 4).T[:3, 3]
        wrench = self._wrench.convert(raw, q, origin)
        self._state = ArmState(q, np.array(seen.dq), wrench, self._fault, tip)

    def _raw_wrench(self, seen: Any) -> tuple[Array, Array, Array]:
        end = np.array(seen.O_T_EE).reshape(4, 4).T
        stiffness = np.array(seen.EE_T_K).reshape(4, 4).T
        return np.array(seen.O_F_ext_hat_K), np.array(seen.q), (end @ stiffness)[:3, 3]

    def _problem(self, seen: Any) -> str:
        mode = self._mode(seen)
        if mode == "kUserStopped":
            return USER_STOP
        errors = named_errors(seen.current_errors)
        if errors or mode in ("kReflex", "kOther", "kAutomaticErrorRecovery"):
            return explained(f"the robot is in {mode} {' '.join(errors)}".strip())
        if mode == "kGuiding":
            return "the robot is being guided by hand: let go of the buttons, call arm/recover"
        return ""

    def _mode(self, seen: Any) -> str:
        return str(seen.robot_mode).rpartition(".")[2]

    def _await_health(self) -> str:
        deadline = self._clock() + self._params.recovery_timeout
        while True:
            self._panda.refresh_state()
            problem = self._problem(self._panda.get_state())
            if not problem or self._clock() >= deadline:
                return problem
            self._sleep(_POLL)

    def _set_thresholds(self, panda: Any) -> None:
        """Upper thresholds stop the robot; the lower ones only flag a contact."""
        torques = list(self._params.collision_torques)
        forces = [self._params.collision_force] * 6
        panda.get_robot().set_collision_behavior(
            [0.5 * value for value in torques], torques, [0.5 * value for value in forces], forces
        )
