"""Keeps track of what the arm has been commanded to do, from the trajectories that were issued."""

from __future__ import annotations

import numpy as np

from flowbothd_common.motion import JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.arm.trajectory import JointState, state_at


class Commander:
    """The commanded joint state at any time, as a JointTrajectoryController would have it.

    A new trajectory replaces the running one at the moment it is issued and is entered from the
    state that was commanded then.
    """

    def __init__(self) -> None:
        self._trajectory: JointTrajectory | None = None
        self._start: JointState | None = None
        self._since = 0.0

    def reset(self, position: Array) -> None:
        """The arm is known to rest at (J,) [rad]."""
        self._trajectory = None
        self._start = JointState.at_rest(position)

    def issue(self, trajectory: JointTrajectory, now: float) -> None:
        """A trajectory goes out at `now` [s, node clock].

        Raises:
            RuntimeError: `reset` has never told where the arm is.
        """
        self._start = self.state(now)
        self._trajectory = trajectory
        self._since = now

    def state(self, now: float) -> JointState:
        """Commanded state at `now`.

        Raises:
            RuntimeError: `reset` has never told where the arm is.
        """
        if self._start is None:
            raise RuntimeError("the commander was not told where the arm is; call reset first")
        if self._trajectory is None:
            return self._start
        return state_at(self._trajectory, self._start, now - self._since)

    def finished(self, now: float) -> bool:
        """Whether the last trajectory has run out by `now`."""
        return self._trajectory is None or now - self._since >= self._trajectory.times[-1]

    def fraction(self, now: float) -> float:
        """How much of the last trajectory's time has passed, 0..1."""
        if self._trajectory is None:
            return 1.0
        return float(np.clip((now - self._since) / self._trajectory.times[-1], 0.0, 1.0))
