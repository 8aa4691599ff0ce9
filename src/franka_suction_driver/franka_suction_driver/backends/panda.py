"""Panda (FER) through panda-python: a 1 kHz C++ controller fed from our trajectories."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from flowbothd_common.errors import ParameterError
from flowbothd_common.motion import JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.arm.commanded_state import CommandedState
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.arm.trajectory import joint_stop
from franka_suction_driver.backend_params import PandaParams
from franka_suction_driver.backends.acceptance import objection
from franka_suction_driver.backends.library import LibraryError, explained, load_panda_py
from franka_suction_driver.backends.panda_link import PandaLink
from franka_suction_driver.backends.panda_reading import PandaReading
from franka_suction_driver.backends.protocol import NOTHING_TO_RECOVER, ArmState, BackendError
from franka_suction_driver.backends.reconnecting import Reconnecting
from franka_suction_driver.backends.robot_modes import clearable, problem
from franka_suction_driver.backends.wrench import ExternalWrench

_log = logging.getLogger(__name__)
_POLL = 0.05
"""Pause between two looks at the robot while something is awaited [s]."""
_SILENT = 0.1
"""Age of the robot's state that counts as silence [s]: states come every millisecond, and libfranka
gives up only later."""
_BRAKING = 2.0
"""Longest wait for the arm to come to rest before the controller is stopped [s]: a stop within the
limits takes well under a second."""
# States that may end by themselves within the time of a recovery.
_PASSING = ("kReflex", "kMove", "kAutomaticErrorRecovery")


class PandaArm:
    """ArmBackend over panda-python.

    Python only writes targets; the torque loop runs in panda-python's own thread. That thread
    stores its errors until somebody asks, so the feeding loop asks at every turn and latches what
    it hears. panda-python recovers by itself whenever a controller is started: this class starts
    one only on a robot whose mode was read and is idle without errors. Nothing is set before the
    mode is known either: libfranka refuses every setting in any other mode.

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
        if not params.force_limit < params.collision_force:
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
        self._commanded = CommandedState()
        self._link: PandaLink | None = None
        self._reconnecting = Reconnecting(self._open, params.robot_ip)
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()
        self._fault = ""
        self._state: ArmState | None = None
        self._robot_time = self._given_time = self._guarded_time = -1.0
        self._advanced = 0.0

    def connect(self) -> None:
        """Reach the robot and read its mode; only where that allows it, set and hold."""
        link = self._open()
        try:
            reading = link.read()
            with self._lock:
                self._link = link
                self._fault = ""
                self._take(reading)
                if not self._fault:
                    self._begin(link)
        except BackendError as error:
            with self._lock:
                self._fail(error)
            if self._link is None:
                link.discard()
                raise

    def state(self) -> ArmState | None:
        """Newest state; read from the robot where the feeding loop does not run."""
        with self._lock:
            if self._link is not None and not self._link.running:
                self._measure()
            if self._state is None:
                return None
            fresh = self._link is not None and self._robot_time != self._given_time
            self._given_time = self._robot_time
            return replace(self._state, fresh=fresh, fault=self._fault)

    def follow(self, trajectory: JointTrajectory) -> str:
        """Take over a trajectory from the state that is commanded now."""
        with self._lock:
            if self._fault:
                return self._fault
            if self._link is None or not self._link.running:
                return "the robot is not connected"
            now = self._clock()
            commanded = self._commanded.state(now)
            reason = objection(trajectory, self._limits, commanded, self._start_tolerance)
            if reason:
                self.hold()
            else:
                self._commanded.issue(trajectory, now)
            return reason

    def hold(self) -> None:
        """Brake all joints within their limits."""
        with self._lock:
            if self._link is None or not self._link.running:
                return
            now = self._clock()
            commanded = self._commanded.state(now)
            if commanded.velocity.any():
                names = self._kinematics.joint_names
                self._commanded.issue(joint_stop(names, commanded, self._limits), now)

    def recover(self) -> str:
        """Clear the fault by the robot's documented way, then hold where the arm stands."""
        with self._lock:
            if not self._fault:
                return "the robot is not connected" if self._link is None else NOTHING_TO_RECOVER
        self._end_feeding()
        try:
            link = self._link or self._reconnecting.result(self._params.recovery_timeout)
            with self._lock:
                self._link = link
                self._fault = self._healed(link)
                if not self._fault:
                    self._begin(link)
                    _log.info("recovered on request")
                return self._fault
        except BackendError as error:
            with self._lock:
                self._fault = ""
                self._fail(error)
                return self._fault

    def tare(self) -> str:
        """Take the present wrench for zero."""
        with self._lock:
            if self._link is None:
                return self._fault or "the robot is not connected"
            try:
                seen = self._link.read()
            except BackendError as error:
                return str(error)
            if seen.wrench is None or seen.stiffness is None:
                return seen.trouble
            if not self._wrench.tare(seen.wrench, seen.q, seen.stiffness):
                return "no wrench is measured here: the arm is near a singularity"
            return ""

    def close(self) -> None:
        """Brake, stop the controller, end the thread."""
        self._end_feeding()
        with self._lock:
            link, self._link = self._link, None
            if link is not None:
                link.discard()

    def feed(self) -> bool:
        """One turn of the feeding loop; whether there is to be another."""
        link = self._link
        if link is None or not link.running or self._closing.is_set():
            return False
        try:
            # Sleeps until the next turn, and raises what the control thread has run into.
            link.turn()
            with self._lock:
                target = self._commanded.state(self._clock())
                link.command(target.position, target.velocity)
                self._measure()
                self._guard(target.position)
        except BackendError as error:
            self._latch(error)
            return False
        return link.running

    def _open(self) -> PandaLink:
        if self._library is None:
            self._library = load_panda_py()
        if not self._params.robot_ip:
            raise BackendError("no robot address", hint="set panda.robot_ip, or `up robot --robot`")
        return PandaLink(self._library, self._params.robot_ip)

    def _begin(self, link: PandaLink) -> None:
        """Set the thresholds and start the controller where the arm stands."""
        link.set_thresholds(self._params)
        reading = link.read()
        if reading.trouble:
            raise BackendError(reading.trouble)
        self._commanded.reset(reading.q)
        link.start(reading.q, self._params)
        self._closing.clear()
        self._measure()
        if self._threaded:
            self._thread = threading.Thread(target=self._run, name="panda", daemon=True)
            self._thread.start()

    def _run(self) -> None:
        try:
            while self.feed():
                pass
        except Exception as error:
            # The last place where a fault of ours can stop the arm: the thread would end unheard.
            _log.exception("the loop that feeds the controller has failed")
            what = "the loop that feeds the controller has failed"
            self._latch(BackendError(what, got=repr(error), hint="see the log; call arm/recover"))

    def _end_feeding(self) -> None:
        """Brake and stop the controller; not with the lock held, which the loop needs to end."""
        self.hold()
        link, deadline = self._link, self._clock() + _BRAKING
        while link is not None and link.running and self._clock() < deadline:
            if self._commanded.finished(self._clock()):
                break
            if self._threaded:
                self._sleep(_POLL)
            else:
                self.feed()
        self._closing.set()
        if self._thread is not None:
            self._thread.join(timeout=1.0)
        with self._lock:
            self._thread = None
            self._stop(self._link)

    def _stop(self, link: PandaLink | None) -> None:
        if link is None:
            return
        try:
            link.stop()
        except LibraryError as error:
            _log.warning("%s", error)
            if error.lost:
                self._fail(error)

    def _healed(self, link: PandaLink) -> str:
        """Do what is documented for the robot's mode; empty once it is idle, or what it is in."""
        seen = link.read()
        if clearable(seen.mode, seen.errors):
            link.clear_errors(seen.errors)
        deadline = self._clock() + self._params.recovery_timeout
        while True:
            seen = link.read()
            self._take(seen)
            wrong = problem(seen.mode, seen.errors, controlled=False) or seen.trouble
            if not wrong or seen.mode not in _PASSING or self._clock() >= deadline:
                return wrong
            self._sleep(_POLL)

    def _latch(self, error: BackendError) -> None:
        """The feeding loop has ended: the arm has stopped, or is stopped now."""
        with self._lock:
            self._fail(error)
            self._stop(self._link)
            self._measure()
        _log.error("the arm has stopped: %s", self._fault)

    def _fail(self, error: BackendError) -> None:
        """Make an error the fault; a dead connection is given up, a moving arm brakes."""
        lost = isinstance(error, LibraryError) and error.lost
        # Braking begins once: a brake that is begun at every turn never ends.
        begins = not self._fault
        if lost or begins:
            self._fault = str(error)
        if lost and self._link is not None:
            link, self._link = self._link, None
            link.discard()
        elif begins:
            self.hold()

    def _guard(self, target: Array) -> None:
        """Brake and latch on silence, on too much force, and on an arm that does not follow.

        The last two are judged on new measurements only: an old one lags behind any target.
        """
        state = self._state
        if state is None or self._fault:
            return
        silence = self._silence()
        if silence:
            self._fail(BackendError(silence))
            _log.error("the arm brakes: %s", self._fault)
        if self._robot_time == self._guarded_time:
            return
        self._guarded_time = self._robot_time
        force = 0.0 if state.wrench is None else float(np.linalg.norm(state.wrench[:3]))
        lag = float(np.abs(state.positions - target).max())
        # Written so that a value that is not finite is beyond its limit.
        if not force <= self._params.force_limit:
            what = f"force limit: {force:.0f} N (panda.force_limit {self._params.force_limit:g} N)"
        elif not lag <= self._params.lag_limit:
            what = f"the arm is {lag:.2f} rad off its target (panda.lag_limit)"
        else:
            return
        self._fail(BackendError(explained(what)))
        _log.error("the arm brakes: %s", self._fault)

    def _measure(self) -> None:
        """Read the robot; what cannot be read or used is a fault and leaves the state as it was."""
        if self._link is None:
            return
        try:
            self._take(self._link.read())
        except BackendError as error:
            self._fail(error)

    def _take(self, seen: PandaReading) -> None:
        """Make a reading the newest state, and what it says is wrong the fault."""
        link = self._link
        running = link is not None and link.running
        wrong = problem(seen.mode, seen.errors, controlled=running) or seen.trouble
        # Where nothing is commanded, the state that the robot is in now says how to go on.
        if wrong and not (self._fault and running):
            self._fault = wrong
            self.hold()
        wrench = None
        if seen.wrench is not None and seen.stiffness is not None:
            wrench = self._wrench.convert(seen.wrench, seen.q, seen.stiffness)
        tip = None if seen.end is None else seen.end[:3, 3]
        self._state = ArmState(seen.q, seen.dq, wrench, self._fault, tip)
        if seen.time != self._robot_time:
            self._robot_time, self._advanced = seen.time, self._clock()

    def _silence(self) -> str:
        """Say that the control loop sees no new states, before libfranka gives up on them."""
        silent = self._clock() - self._advanced
        if self._link is None or silent <= _SILENT:
            return ""
        return (
            f"no new state from the robot for {silent:.1f} s: is its cable plugged in? Then call "
            "arm/recover"
        )
