"""Finds panda-python, and turns what it raises into words that help."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

from franka_suction_driver.backends.protocol import BackendError

INSTALL = (
    "install it beside ROS without its numpy: "
    "`pip install --no-deps panda-python==1.1.1 websockets`"
)
_REMEDIES = {
    "cartesian_reflex": "the contact force exceeded panda.collision_force: free the arm, then "
    "call arm/recover; raise the threshold only if the part needs more force than it",
    "joint_reflex": "a joint torque exceeded panda.collision_torques: free the arm, then call "
    "arm/recover",
    "communication_constraints_violation": "the control loop came too late: use a real-time "
    "kernel, a network card for the robot alone, and no camera on it; then call arm/recover",
    "joint_velocity_violation": "lower safety.speed_scale, then call arm/recover",
    "self_collision_avoidance_violation": "guide the arm free by hand, then call arm/recover",
    "power_limit_violation": "lower safety.speed_scale, then call arm/recover",
    "tau_j_range_violation": "check the end effector's mass in Desk, then call arm/recover",
}


def load_panda_py() -> ModuleType:
    """The module panda_py.

    Raises:
        BackendError: it is not installed, or does not work with what is.
    """
    try:
        library = importlib.import_module("panda_py")
        # The package does not import all of its parts by itself.
        for part in ("controllers", "libfranka"):
            importlib.import_module(f"panda_py.{part}")
    except ImportError as error:
        raise BackendError("panda-python is not usable", got=str(error), hint=INSTALL) from error
    return library


def connection_problem(library: Any, address: str, error: RuntimeError) -> BackendError:
    """What the failure to connect means and what to do."""
    if isinstance(error, library.IncompatibleVersionError):
        wanted = getattr(error, "libfranka_version", None) or "see the message"
        return BackendError(
            f"the robot at {address} speaks another protocol: {error}",
            hint=f"install the panda-python build for libfranka {wanted} (docs/tutorials/own_robot.md)",
        )
    text = str(error)
    if "FCI" in text:
        hint = "unlock the joints and activate FCI in Desk; it is off after every start"
    else:
        hint = f"ping {address}; is the cable in the control unit's port and panda.robot_ip right?"
    return BackendError(f"cannot reach the robot at {address}: {text}", hint=hint)


def named_errors(errors: Any) -> list[str]:
    """Names of the libfranka errors that are set."""
    return [n for n in dir(errors) if not n.startswith("_") and getattr(errors, n) is True]


def explained(text: str) -> str:
    """An error text with the remedy for the first libfranka error in it."""
    for name, remedy in _REMEDIES.items():
        if name in text:
            return f"{text}; {remedy}"
    return f"{text}; look at the robot, then call arm/recover"
