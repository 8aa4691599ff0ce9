"""Statistics of one motion, as its result reports them."""

from __future__ import annotations

import numpy as np

from flowbothd_common.motion import JointState, MotionKind, MotionResult, RobotObservation
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.execution.motion_step import Termination


class MotionStats:
    """Accumulate tool motion, peak wrench and tracking error over one motion.

    Args:
        kind: Which motion.
        robot: Gives the tool's pose at the measured joint positions.
        observation: At the begin of the motion.
    """

    def __init__(self, kind: MotionKind, robot: Kinematics, observation: RobotObservation) -> None:
        self._kind = kind
        self._robot = robot
        self._began = observation.time
        self._tool_start = robot.pose(np.asarray(observation.positions, dtype=float))
        self._peak = np.zeros(6)
        self._max_lag = 0.0

    def add(self, observation: RobotObservation, commanded: JointState) -> None:
        """Take in one observation."""
        lag = float(np.abs(observation.positions - commanded.position).max())
        self._max_lag = max(self._max_lag, lag)
        if observation.wrench is None:
            return
        for part in (slice(0, 3), slice(3, 6)):
            if np.linalg.norm(observation.wrench[part]) > np.linalg.norm(self._peak[part]):
                self._peak[part] = observation.wrench[part]

    def result(
        self, termination: Termination, fraction: float, observation: RobotObservation
    ) -> MotionResult:
        """Return the motion's result, with the tool as measured now."""
        return MotionResult(
            kind=self._kind,
            reason=termination.reason,
            message=termination.message,
            reached_fraction=fraction,
            tool_start=self._tool_start,
            tool_end=self._robot.pose(np.asarray(observation.positions, dtype=float)),
            contact=termination.contact or observation.vacuum,
            vacuum=observation.vacuum,
            peak_wrench=self._peak.copy(),
            max_lag=self._max_lag,
            duration=observation.time - self._began,
        )
