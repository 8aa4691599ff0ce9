"""What a trajectory must be before hardware follows it: the controller's rules and the arm's."""

from __future__ import annotations

import numpy as np

from flowbothd_common.motion import JointTrajectory
from franka_suction_driver.limits import JointLimits
from franka_suction_driver.trajectory import JointState

_START_SLACK = 0.01


def objection(trajectory: JointTrajectory, limits: JointLimits, commanded: JointState) -> str:
    """Why the trajectory must not be followed, or nothing.

    The rules of JointTrajectoryController, which rejects with only a line in its log, and more:
    positions, velocities and accelerations, from the state the arm is commanded to have, to rest,
    inside every limit.

    Args:
        trajectory: In the order of the arm's joints.
        limits: Of the arm.
        commanded: State that the trajectory is entered from.
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
    # In one interval no joint gets further than at full speed; a jump does.
    reach = limits.velocity * float(times[0]) + _START_SLACK
    jump = np.abs(trajectory.positions[0] - commanded.position)
    if (jump > reach).any():
        worst = int((jump - reach).argmax())
        return (
            f"it starts {jump[worst]:.3f} rad from where {trajectory.joint_names[worst]} is "
            f"commanded to be, at most {reach[worst]:.3f} rad can be covered by its first point"
        )
    violation = limits.violation(trajectory)
    return f"beyond a limit: {violation}" if violation is not None else ""
