"""The fastest stop of all joints, within every limit also between its points."""

from __future__ import annotations

from flowbothd_common.motion import JointTrajectory
from franka_suction_driver.arm.fine_check import fine_violation
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.arm.trajectory import SAMPLE, JointState, brake, interpolable, sampled

_STEPS = (SAMPLE, SAMPLE / 2, SAMPLE / 4)


def joint_stop(names: tuple[str, ...], start: JointState, limits: JointLimits) -> JointTrajectory:
    """Fastest stop of all joints within the limits.

    Where a controller's quintics would overshoot a limit between two points, the points are set
    closer: from hard manoeuvres at full acceleration they overshot by a hundredth.
    """
    profile = brake(start, *interpolable(limits)[1:])
    for step in _STEPS[:-1]:
        trajectory = sampled(names, profile, step)
        if fine_violation(limits, trajectory, start) is None:
            return trajectory
    return sampled(names, profile, _STEPS[-1])
