"""Names, limits and start pose of the arm, as parameters."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from flowbothd_common.parameters import parameter

ARM_JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
"""Joint names of the robot description, base to tip."""
_FER = (3.75, 1.875, 2.5, 3.125, 3.75, 5.0, 5.0)
"""Joint accelerations of the Franka Emika Robot [rad/s^2]: a quarter of those that its data sheet
allows, which leaves room for the controller."""


@dataclass(frozen=True)
class RobotParams:
    """Names, limits and start pose of the arm."""

    joint_names: tuple[str, ...] = parameter(ARM_JOINTS, "Arm joints, base to tip")
    base_frame: str = parameter("panda_link0", "Frame of all goals and poses")
    tip_frame: str = parameter("suction_tip", "Frame at the centre of the cup's lip")
    description_file: str = parameter(
        "", "URDF file to use instead of the composed description; empty = compose"
    )
    start_positions: tuple[float, ...] = parameter(
        (0.0, -pi / 4, 0.0, -3 * pi / 4, 0.0, pi / 2, pi / 4),
        "Joint positions that Retreat returns to [rad]",
    )
    lower_limits: tuple[float, ...] = parameter(
        (), "Lowest joint positions [rad]; empty = the description's", element=float
    )
    upper_limits: tuple[float, ...] = parameter(
        (), "Highest joint positions [rad]; empty = the description's", element=float
    )
    velocity_limits: tuple[float, ...] = parameter(
        (), "Largest joint velocities [rad/s]; empty = the description's", element=float
    )
    acceleration_limits: tuple[float, ...] = parameter(
        _FER, "Largest joint accelerations [rad/s^2]", minimum=0.01
    )
    jerk_limits: tuple[float, ...] = parameter(
        (500.0,) * 7, "Largest joint jerks [rad/s^3]", minimum=1.0
    )
    position_margin: float = parameter(
        0.05, "Kept distance from the joint position limits [rad]", minimum=0.0, maximum=0.5
    )
    speed_scale: float = parameter(
        0.5,
        "Approach and Retreat: joint speed as a part of the limits, before safety.speed_scale",
        minimum=0.01,
        maximum=1.0,
    )
