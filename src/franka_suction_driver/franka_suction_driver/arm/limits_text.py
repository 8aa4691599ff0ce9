"""The limits that hold, in one line for the log of a node's start."""

from __future__ import annotations

from collections.abc import Sequence

from franka_suction_driver.arm.params import RobotParams
from franka_suction_driver.backend_params import ArmNodeParams
from franka_suction_driver.params import MotionParams


def motion_limits(params: MotionParams) -> str:
    """Return the limits within which motion_node moves the arm."""
    safety = params.safety
    return (
        f"limits: dry_run {'on, nothing moves' if safety.dry_run else 'off'}; "
        f"force limit {safety.force_limit:g} N; "
        f"workspace {_vector(safety.workspace_min)} .. {_vector(safety.workspace_max)} m; "
        f"speed scale {safety.speed_scale:g}; "
        f"table at {params.collision.table_height:g} m; {_joint_limits(params.robot)}"
    )


def arm_limits(params: ArmNodeParams) -> str:
    """Return the limits that arm_node holds on the way to the hardware."""
    panda = params.panda
    if params.backend == "topic":
        held = "force limit and collision thresholds are the controller's"
    else:
        held = (
            f"force limit {panda.force_limit:g} N; collision thresholds "
            f"{panda.collision_force:g} N, {_vector(panda.collision_torques)} Nm"
        )
    return f"limits: backend {params.backend}; {held}; {_joint_limits(params.robot)}"


def _joint_limits(robot: RobotParams) -> str:
    """Return what the joint limits come from; accelerations and jerks are always parameters."""
    given = [
        name for name in ("lower_limits", "upper_limits", "velocity_limits") if getattr(robot, name)
    ]
    description = robot.description_file or "the composed description"
    if not given:
        return f"joint limits of {description}"
    parameters = ", ".join(f"robot.{name}" for name in given)
    return f"joint limits of {parameters}" + ("" if len(given) == 3 else f" and {description}")


def _vector(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{value:g}" for value in values) + "]"
