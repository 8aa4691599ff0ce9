"""Commanded state of the arm at any time, from the trajectories that were issued."""

from __future__ import annotations

from flowbothd_common.motion import JointState, JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.arm.trajectory import state_at


class CommandedState:
    """The commanded joint state at any time, as a JointTrajectoryController computes it.

    A new trajectory replaces the running one at the moment it is issued and is entered from the
    state that was commanded then.
    """

    def __init__(self) -> None:
        self._trajectory: JointTrajectory | None = None
        self._start: JointState | None = None
        self._since = 0.0

    def reset(self, position: Array) -> None:
        """Set the commanded state to rest at (J,) [rad]."""
        self._trajectory = None
        self._start = JointState.at_rest(position)

    def issue(self, trajectory: JointTrajectory, now: float) -> None:
        """Replace the running trajectory at `now` [s, node clock].

        Raises:
            RuntimeError: `reset` was never called.
        """
        self._start = self.state(now)
        self._trajectory = trajectory
        self._since = now

    def state(self, now: float) -> JointState:
        """Return the commanded state at `now` [s, node clock].

        Raises:
            RuntimeError: `reset` was never called.
        """
        if self._start is None:
            raise RuntimeError("the commanded state is unknown; call reset with the arm's position")
        if self._trajectory is None:
            return self._start
        return state_at(self._trajectory, self._start, now - self._since)

    def finished(self, now: float) -> bool:
        """Return True if the last trajectory has run out by `now`."""
        return self._trajectory is None or now - self._since >= self._trajectory.times[-1]
