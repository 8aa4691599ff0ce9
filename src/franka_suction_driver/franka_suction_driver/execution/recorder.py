"""Collects what the result of a motion has to tell."""

from __future__ import annotations

import numpy as np

from flowbothd_common.motion import JointState, MotionKind, MotionResult, RobotObservation
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.execution.motion_step import Ending


class Recorder:
    """Measured tool motion, peak wrench and lag between begin and end of one motion.

    Args:
        kind: Which motion.
        robot: For the tool's pose at the measured joint positions.
        observation: At the begin.
    """

    def __init__(self, kind: MotionKind, robot: Kinematics, observation: RobotObservation) -> None:
        self._kind = kind
        self._robot = robot
        self._began = observation.time
        self._tool_start = robot.pose(np.asarray(observation.positions, dtype=float))
        self._peak = np.zeros(6)
        self._max_lag = 0.0

    def see(self, observation: RobotObservation, commanded: JointState) -> None:
        """Note one observation."""
        lag = float(np.abs(observation.positions - commanded.position).max())
        self._max_lag = max(self._max_lag, lag)
        if observation.wrench is None:
            return
        for part in (slice(0, 3), slice(3, 6)):
            if np.linalg.norm(observation.wrench[part]) > np.linalg.norm(self._peak[part]):
                self._peak[part] = observation.wrench[part]

    def result(
        self, ending: Ending, fraction: float, observation: RobotObservation
    ) -> MotionResult:
        """The motion's result, the tool measured now."""
        return MotionResult(
            kind=self._kind,
            reason=ending.reason,
            message=ending.message,
            reached_fraction=fraction,
            tool_start=self._tool_start,
            tool_end=self._robot.pose(np.asarray(observation.positions, dtype=float)),
            contact=ending.contact or observation.vacuum,
            vacuum=observation.vacuum,
            peak_wrench=self._peak.copy(),
            max_lag=self._max_lag,
            duration=observation.time - self._began,
        )
