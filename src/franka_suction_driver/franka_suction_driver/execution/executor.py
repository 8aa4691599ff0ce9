"""Runs one motion at a time: planned, then ticked; the same behind nodes and in stepped worlds.

`start` plans and begins; where planning must not block, `prepare` can run in another thread and
`begin` takes its outcome. `tick` never plans.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from flowbothd_common.errors import MotionRejectedError
from flowbothd_common.motion import (
    JointTrajectory,
    MotionGoal,
    MotionKind,
    MotionReason,
    MotionResult,
    RobotObservation,
)
from flowbothd_common.types import Array, as_cloud
from franka_suction_driver.arm.commanded_state import CommandedState
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import robot_limits
from franka_suction_driver.arm.trajectory import joint_stop
from franka_suction_driver.execution.audit import (
    AuditSink,
    NoAudit,
    goal_entry,
    result_entry,
    trajectory_entry,
)
from franka_suction_driver.execution.cartesian_planner import CartesianPlanner, SlowZones
from franka_suction_driver.execution.goals import checked_goal
from franka_suction_driver.execution.motion_factory import MotionFactory, PlannedGoal
from franka_suction_driver.execution.motion_stats import MotionStats
from franka_suction_driver.execution.motion_step import (
    MotionUpdate,
    RunningMotion,
    Step,
    Termination,
)
from franka_suction_driver.execution.safety_monitor import SafetyMonitor, slowed, workspace
from franka_suction_driver.params import MotionParams
from franka_suction_driver.planning.collision import CollisionChecker, Margins
from franka_suction_driver.planning.occlusion import OccludedPart, hidden_points
from franka_suction_driver.planning.planner import PlannedMotion, Planner

_log = logging.getLogger(__name__)
_AT_REST = 0.05
"""Joint speed of an arm that stands [rad/s]: above the noise of measured velocities."""
_SAME_PLACE = 0.02
"""Distance of a joint from its command within which the command is believed [rad]: what a
controller leaves at rest under load."""


def _twin(robot: Kinematics) -> Kinematics:
    return Kinematics(robot.urdf, robot.joint_names, robot.base_frame, robot.tip_frame)


class MotionExecutor:
    """Approach, Probe, FlowStep and Retreat of one arm.

    Args:
        robot: The arm.
        params: Parameters of the motion core.
        seed: Of all random choices in planning; the n-th motion of two executors with the same
            seed and inputs is the same.
        audit: Is told every goal, trajectory and result.

    Raises:
        ParameterError: limits or the start pose do not fit the robot.
    """

    def __init__(
        self,
        robot: Kinematics,
        params: MotionParams,
        seed: int | None = None,
        audit: AuditSink | None = None,
    ) -> None:
        self.robot = robot
        self.params = params = slowed(params)
        self.limits = robot_limits(robot, params.robot)
        self._audit = audit or NoAudit()
        self._safety = SafetyMonitor(params.safety, robot)
        box = self.limits.box(params.robot.position_margin)
        # Pinocchio's data is not safe to share with a thread that plans.
        self._planner = Planner(_twin(robot), self.limits, params)
        # Of a held part nobody knows what is scene: steps keep clear of table and arm alone.
        bare = CollisionChecker(
            _twin(robot),
            Margins(self_collision=0.0, table=0.003),
            table_height=params.collision.table_height,
            workspace=workspace(params.safety),
        )
        zones = SlowZones(params.safety.slow_singular_value, params.safety.slow_margin)
        cartesian = CartesianPlanner(robot, self.limits, box, params.planning.tilt_slack, zones)
        self._factory = MotionFactory(robot, self.limits, cartesian, bare, params)
        self._seed = params.seed if seed is None else seed
        self._motions = 0
        self._commanded = CommandedState()
        self._commanded_once = False
        self._running: RunningMotion | None = None
        self._stats: MotionStats | None = None
        self._goal: MotionGoal | None = None
        self._observed: RobotObservation | None = None
        self._part = OccludedPart()
        self._eye: Array | None = None
        self._stop_request: Termination | None = None
        self._last_request: Termination | None = None

    @property
    def busy(self) -> bool:
        """Whether a motion is running."""
        return self._stats is not None

    def is_free(self, q: Array) -> bool:
        """Whether the arm touches nothing at joint positions (J,), by the planner's scene."""
        return self._planner.collision.free(q)

    def set_obstacles(self, points: object | None, eye: object | None = None) -> None:
        """Replace the observed object.

        Args:
            points: (N, 3) in base [m], or None.
            eye: (3,) the camera in base [m]; if given, room behind the points is kept out of, see
                `hidden_points`.

        Raises:
            InvalidCloudError: wrong shape, or values that are not finite.
        """
        hidden = None
        self._eye = None if eye is None else np.asarray(eye, dtype=float)
        if points is not None and self._eye is not None:
            collision = self.params.collision
            cloud = as_cloud(points, "obstacle cloud", min_points=0)
            hidden = hidden_points(
                cloud, self._eye, collision.hidden_depth, collision.obstacle_cell
            )
        self._planner.collision.set_points(points, hidden)

    def start(self, goal: MotionGoal, observation: RobotObservation) -> None:
        """Plan and begin a motion; what comes of it is told by `tick`.

        Raises:
            MotionRejectedError: the goal is malformed, or another motion is running.
        """
        self.begin(self.prepare(goal, observation), observation)

    def prepare(self, goal: MotionGoal, observation: RobotObservation) -> PlannedGoal:
        """Check and plan a goal; may take a second, moves nothing, and is safe in one other thread.

        Raises:
            MotionRejectedError: the goal is malformed, outside the envelope, or another motion is
                running.
        """
        if self.busy:
            raise MotionRejectedError(
                f"cannot start {goal.kind.value}: another motion is running",
                hint="wait for its result, or stop it first",
            )
        checked = checked_goal(goal)
        self._safety.check_goal(checked)
        self._safety.check_observation(observation)
        rng = np.random.default_rng([self._seed, self._motions])
        start = np.array(observation.positions, dtype=float)
        planned = None
        if checked.kind is MotionKind.APPROACH:
            contact, direction = checked.contact, checked.direction
            if contact is not None and direction is not None:
                planned = self._planner.approach(start, contact, direction, checked.joint, rng)
                self._part.approached(checked, self._planner.collision.points)
        elif checked.kind is MotionKind.RETREAT:
            planned = self._plan_retreat(start, rng)
        return PlannedGoal(checked, planned)

    def _plan_retreat(self, start: Array, rng: np.random.Generator) -> PlannedMotion:
        """By what is seen and what is remembered; where that leaves no way, by what is seen."""
        seen, eye = self._planner.collision.points, self._eye
        self.set_obstacles(self._part.completed(seen), eye)
        planned = self._planner.retreat(start, rng, self._part.plate)
        if planned.trajectory is None:
            self.set_obstacles(seen, eye)
            planned = self._planner.retreat(start, rng)
        return planned

    def begin(self, prepared: PlannedGoal, observation: RobotObservation) -> None:
        """Begin a prepared motion from where the arm stands.

        Raises:
            MotionRejectedError: another motion is running, or a stop is latched.
        """
        if self.busy:
            raise MotionRejectedError("cannot begin: another motion is running")
        self._safety.check_observation(observation)
        self._observed = observation
        self._safety.check_goal(prepared.goal)
        self._audit.write("goal", observation.time, goal_entry(prepared.goal))
        self._motions += 1
        self._stop_request = self._last_request = None
        self._goal = prepared.goal
        kind = prepared.goal.kind
        self._stats = MotionStats(kind, self.robot, observation)
        self._safety.restart()
        self._running = None
        known = self._settle_commanded(observation)
        speed = float(np.abs(observation.velocities).max())
        # An arm that trembles where it was told to stand may go on; one that travels may not.
        if not speed <= _AT_REST and not known:
            message = f"the arm still moves ({speed:.2f} rad/s); wait until it rests"
            self._stop_request = Termination(MotionReason.REJECTED, message)
            return
        try:
            start = self._commanded.state(observation.time)
            outcome = self._factory.create(prepared, observation, start)
        except MotionRejectedError as error:
            outcome = Termination(MotionReason.REJECTED, str(error))
        if isinstance(outcome, Termination):
            self._stop_request = outcome
        else:
            self._running = outcome

    def stop(self, reason: MotionReason = MotionReason.STOPPED, message: str = "") -> bool:
        """Bring the running motion to rest at the next tick; whether there was one."""
        if not self.busy:
            return False
        self._stop_request = Termination(reason, message or "stopped on request")
        self._last_request = self._stop_request
        return True

    def tick(self, observation: RobotObservation) -> MotionUpdate:
        """Advance the running motion to `observation.time`; to be called at 50 to 100 Hz."""
        stats = self._stats
        if stats is None:
            return MotionUpdate()
        observation = self._usable(observation)
        now = observation.time
        commanded = self._commanded.state(now)
        stats.add(observation, commanded)
        if self._running is None:
            termination = self._stop_request or Termination(MotionReason.REJECTED, "nothing to do")
            return self._finish(stats, termination, 0.0, observation)
        problem = self._safety.watch(observation, commanded)
        if problem is not None and self._last_request is None:
            self._stop_request = self._last_request = problem
        stopping = self._stop_request is not None
        if self._stop_request is not None:
            request, self._stop_request = self._stop_request, None
            step = self._running.stop(now, commanded, request)
        else:
            step = self._running.tick(now, commanded, observation)
        if step.trajectory is not None and not stopping and self._last_request is None:
            outside = self._safety.leaves(step.trajectory, commanded)
            if outside:
                self._last_request = Termination(MotionReason.UNREACHABLE, outside)
                step = self._running.stop(now, commanded, self._last_request)
        return self._send(stats, step, self._running.fraction, observation)

    def _usable(self, observation: RobotObservation) -> RobotObservation:
        """Return the observation, or the last good one, and stop, if values are not finite."""
        problem = observation.problem()
        if not problem:
            self._observed = observation
            return observation
        if self._last_request is None:
            message = f"stopped: {problem}"
            self._stop_request = Termination(MotionReason.STALE_INPUT, message)
            self._last_request = self._stop_request
        last = self._observed or observation
        return replace(last, time=observation.time, wrench=None)

    def _send(
        self, stats: MotionStats, step: Step, fraction: float, observation: RobotObservation
    ) -> MotionUpdate:
        """Give out what a step came to; in a dry run, show it instead."""
        now, trajectory = observation.time, step.trajectory
        dry = self.params.safety.dry_run
        if trajectory is not None:
            self._audit.write("trajectory", now, trajectory_entry(trajectory, shown=dry))
        if trajectory is not None and dry:
            message = f"dry run: planned {trajectory.times[-1]:.1f} s, nothing moved"
            termination = Termination(MotionReason.STOPPED, message)
            return replace(self._finish(stats, termination, 0.0, observation), shown=trajectory)
        if trajectory is not None:
            self._commanded.issue(trajectory, now)
        if step.termination is not None:
            return self._finish(stats, step.termination, fraction, observation, trajectory)
        return MotionUpdate(trajectory, fraction)

    @property
    def latched(self) -> str:
        """Reason why nothing may move until `clear_stop`; empty if the arm may move."""
        return self._safety.latched

    def halt(self, why: str, now: float) -> bool:
        """Stop, and let nothing move until `clear_stop`; return True if something was moving."""
        self._safety.latch(why)
        self._audit.write("halt", now, {"why": why})
        return self.stop(MotionReason.STOPPED, f"{why}; latched until motion/clear_stop")

    def clear_stop(self, now: float) -> str:
        """Let motion begin again; return the reason of the stop, empty if there was none."""
        why = self._safety.clear_stop()
        self._audit.write("clear_stop", now, {"why": why})
        return why

    def abandon(self, observation: RobotObservation) -> MotionResult:
        """End the running motion now, although the arm may not rest yet; for frozen clocks.

        Raises:
            MotionRejectedError: no motion is running.
        """
        if self._stats is None:
            raise MotionRejectedError("there is no motion to abandon")
        termination = self._last_request or Termination(
            MotionReason.STALE_INPUT, "inputs went silent"
        )
        fraction = self._running.fraction if self._running is not None else 0.0
        update = self._finish(self._stats, termination, fraction, observation)
        if update.result is None:
            raise RuntimeError("finishing a motion gave no result")
        return update.result

    def drop(self, now: float, why: str) -> JointTrajectory | None:
        """Forget the running motion and brake all joints within their limits.

        For a motion that has failed unexpectedly: nothing of its own is called.

        Args:
            now: Node clock [s].
            why: For the audit log.

        Returns:
            The stop, to be sent now; None if nothing moves.
        """
        self._stats = self._running = self._stop_request = None
        if not self._commanded_once:
            return None
        commanded = self._commanded.state(now)
        if not commanded.velocity.any():
            return None
        stop = joint_stop(self.robot.joint_names, commanded, self.limits)
        self._audit.write("drop", now, {"why": why, **trajectory_entry(stop)})
        self._commanded.issue(stop, now)
        return stop

    def _finish(
        self,
        stats: MotionStats,
        termination: Termination,
        fraction: float,
        observation: RobotObservation,
        trajectory: JointTrajectory | None = None,
    ) -> MotionUpdate:
        result = stats.result(termination, fraction, observation)
        self._audit.write("result", observation.time, result_entry(result))
        if self._goal is not None and self._goal.kind is MotionKind.FLOW_STEP:
            self._part.stepped(self._goal, result)
        self._stats = None
        self._running = None
        self._stop_request = None
        if termination.reason is MotionReason.LAGGING:
            # The arm is not where it was commanded to be: the next motion starts where it is seen.
            self._commanded_once = False
        _log.info(
            "%s: %s, %.0f %% of the path, %.2f s, peak %.1f N, lag %.4f rad %s",
            result.kind.value,
            result.reason.value,
            100 * result.reached_fraction,
            result.duration,
            float(np.linalg.norm(result.peak_wrench[:3])),
            result.max_lag,
            result.message,
        )
        return MotionUpdate(trajectory, fraction, result)

    def _settle_commanded(self, observation: RobotObservation) -> bool:
        """Believe the last command where the arm is near it, the measurement otherwise.

        Returns:
            Whether the arm is where it was told to rest.
        """
        measured = np.array(observation.positions, dtype=float)
        if self._commanded_once:
            commanded = self._commanded.state(observation.time)
            near = np.abs(commanded.position - measured).max() < _SAME_PLACE
            if near and not commanded.velocity.any():
                self._commanded.reset(commanded.position)
                return True
        self._commanded_once = True
        self._commanded.reset(measured)
        return False
