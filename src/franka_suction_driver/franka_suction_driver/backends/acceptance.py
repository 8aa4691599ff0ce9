"""What a trajectory must be before hardware follows it: the controller's rules and the arm's."""

from __future__ import annotations

import numpy as np

from flowbothd_common.motion import JointState, JointTrajectory
from flowbothd_common.trajectory_continuity import discontinuity
from franka_suction_driver.arm.limits import JointLimits


def objection(
    trajectory: JointTrajectory, limits: JointLimits, commanded: JointState, start_tolerance: float
) -> str:
    """Why the trajectory must not be followed, or nothing.

    The rules of JointTrajectoryController, which rejects with only a line in its log, and more:
    positions, velocities and accelerations, from the state the arm is commanded to have, to rest,
    inside every limit.

    Args:
        trajectory: In the order of the arm's joints.
        limits: Of the arm.
        commanded: State that the trajectory is entered from.
        start_tolerance: How far beside it the trajectory may begin [rad].
    """
    times, joints = trajectory.times, len(limits.lower)
    if not len(times):
        return "the trajectory has no points"
    for name in ("positions", "velocities", "accelerations"):
        values = getattr(trajectory, name)
        if values.shape != (len(times), joints):
            return f"{name} are {values.shape}, needed are {(len(times), joints)}"
        if not np.isfinite(values).all():
            return f"{name} are not finite"
    if not np.isfinite(times).all() or times[0] <= 0 or (np.diff(times) <= 0).any():
        return "times are not strictly increasing from above 0"
    if trajectory.velocities[-1].any() or trajectory.accelerations[-1].any():
        return "the trajectory does not end at rest: last velocity and acceleration must be zero"
    violation = limits.violation(trajectory)
    if violation is not None:
        return f"beyond a limit: {violation}"
    return discontinuity(
        trajectory.joint_names,
        (commanded.position, commanded.velocity),
        (trajectory.positions[0], trajectory.velocities[0]),
        float(times[0]),
        tolerance=start_tolerance,
        acceleration=limits.acceleration,
    )
