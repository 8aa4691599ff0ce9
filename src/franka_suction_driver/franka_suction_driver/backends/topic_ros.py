"""A robot behind a JointTrajectoryController: trajectories by topic, watched by joint states."""

from __future__ import annotations

import time

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState as JointStateMessage
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

from flowbothd_common.motion import JointTrajectory
from flowbothd_common.ros import qos, received
from flowbothd_common.ros.conversions import to_trajectory
from flowbothd_common.ros.guard import Guard
from franka_suction_driver.arm.commanded_state import CommandedState
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.arm.trajectory import joint_stop
from franka_suction_driver.backends.acceptance import objection
from franka_suction_driver.backends.protocol import NOTHING_TO_RECOVER, ArmState

_PATIENCE = 0.3
"""Time that the arm may be off its command before it counts as a fault [s]: trajectories and joint
states travel."""
_SAME_PLACE = 0.02
"""Joint error below which the arm has arrived [rad]: what a controller leaves at rest."""


class TopicArm:
    """ArmBackend over topics.

    The controller rejects with a line in its own log, so that what became of a trajectory is read
    from the joint states: an arm that does not follow its commands is a fault. The wrench is
    whoever's who measures it; this backend has none.

    Args:
        node: Publishes `controller/joint_trajectory`, subscribes `joint_states`.
        joint_names: The order of all joint vectors.
        limits: What no trajectory may exceed.
        reject_lag: Distance between command and joint state that counts as not following [rad].
        start_tolerance: How far beside its commanded state a trajectory may begin [rad].
        guard: Of the node's callbacks.
    """

    def __init__(
        self,
        node: Node,
        joint_names: tuple[str, ...],
        limits: JointLimits,
        reject_lag: float,
        start_tolerance: float,
        guard: Guard,
    ) -> None:
        self._names, self._limits, self._reject_lag = joint_names, limits, reject_lag
        self._start_tolerance = start_tolerance
        self._commanded = CommandedState()
        self._state: ArmState | None = None
        self._fault = ""
        self._moving = False
        self._behind_since: float | None = None
        self._publisher = node.create_publisher(
            JointTrajectoryMessage, "controller/joint_trajectory", qos.COMMAND
        )
        guard.subscribe(JointStateMessage, "joint_states", self._on_joints, qos.STATE)

    def connect(self) -> None:
        """Nothing to do: topics connect by themselves."""

    def state(self) -> ArmState | None:
        """The newest joint states, by name; None before the first."""
        return self._state

    def follow(self, trajectory: JointTrajectory) -> str:
        """Pass a trajectory on with stamp 0, which controllers read as "start now"."""
        if self._fault or self._state is None:
            return self._fault or "no joint_states yet"
        now = time.monotonic()
        commanded = self._commanded.state(now)
        reason = objection(trajectory, self._limits, commanded, self._start_tolerance)
        if reason:
            self.hold()
            return reason
        self._commanded.issue(trajectory, now)
        self._moving = True
        self._publisher.publish(to_trajectory(trajectory))
        return ""

    def hold(self) -> None:
        """Replace what runs by a short braking trajectory; an empty one would be an error.

        Where the arm does not follow, nobody knows what the controller commands: braking from
        there could be a leap, and what runs ends at rest by itself.
        """
        if self._state is None or self._fault:
            return
        now = time.monotonic()
        commanded = self._commanded.state(now)
        if commanded.velocity.any():
            stop = joint_stop(self._names, commanded, self._limits)
            self._commanded.issue(stop, now)
            self._publisher.publish(to_trajectory(stop))

    def recover(self) -> str:
        """Believe the joint states again; a driver's own recovery is the driver's."""
        if self._state is None:
            return "no joint_states yet"
        if not self._fault:
            return NOTHING_TO_RECOVER
        self._fault, self._behind_since, self._moving = "", None, False
        self._commanded.reset(self._state.positions)
        return ""

    def tare(self) -> str:
        """Not here: the wrench is somebody else's."""
        return "the wrench comes from another driver: tare it there"

    def close(self) -> None:
        """Brake."""
        self.hold()

    def _on_joints(self, message: JointStateMessage) -> None:
        limits = self._limits
        values = received.joint_state(
            message,
            self._names,
            (limits.lower, limits.upper, limits.velocity),
            expected=self._state is None,
        )
        if values is None:
            return
        positions, velocities = values
        self._state = ArmState(positions, velocities, None, self._fault)
        self._watch(positions)

    def _watch(self, positions: np.ndarray) -> None:
        """Notice an arm that does not follow; one that rests may be moved by others."""
        if not self._moving:
            self._commanded.reset(positions)
            return
        now = time.monotonic()
        lag = float(np.abs(positions - self._commanded.state(now).position).max())
        if self._commanded.finished(now) and lag < _SAME_PLACE:
            self._moving = False
        if lag <= self._reject_lag:
            self._behind_since = None
            return
        self._behind_since = self._behind_since or now
        if now - self._behind_since > _PATIENCE and not self._fault:
            self._fault = (
                f"the arm is {lag:.2f} rad off its command: the controller may have rejected the "
                "trajectory, see its log; then call arm/recover"
            )
