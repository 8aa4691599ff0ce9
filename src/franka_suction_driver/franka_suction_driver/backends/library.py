"""Finds panda-python, and turns what it raises into words that help."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from franka_suction_driver.backends.protocol import BackendError

INSTALL = (
    "install it beside ROS without its numpy: "
    "`pip install --no-deps panda-python==1.1.1 websockets`"
)
# What pybind11 makes of C++ exceptions; libfranka's own all become RuntimeError.
RAISED = (RuntimeError, ValueError, TypeError, IndexError, OverflowError, MemoryError)
# How libfranka 0.9.2 words a NetworkException or a ProtocolException; every text is lower case.
_NETWORK = (
    "connection timeout",
    "connection error",
    "connection got interrupted",
    "server closed connection",
    "tcp receive",
    "tcp send",
    "udp receive",
    "udp send",
    "could not send udp",
    "incorrect object size",
    "incorrect tcp message size",
)
_RECONNECT = "check the robot's cable, its power and FCI in Desk, then call arm/recover"
_REMEDIES = {
    "manual error recovery required": "move the arm back inside its limits by hand in Desk, then "
    "call arm/recover",
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


class LibraryError(BackendError):
    """A call of the library has failed.

    Attributes:
        lost: The connection is gone: no further call on the same object can succeed.
    """

    def __init__(self, doing: str, error: BaseException) -> None:
        text = str(error) or type(error).__name__
        self.lost = is_lost(error)
        if self.lost:
            super().__init__(
                f"the connection to the robot was lost: {text} (while {doing})", hint=_RECONNECT
            )
        else:
            super().__init__(explained(f"{doing} failed: {text}"))


@contextmanager
def calling(doing: str) -> Iterator[None]:
    """Turn whatever a library call raises into a LibraryError that says what was being done."""
    try:
        yield
    except RAISED as error:
        raise LibraryError(doing, error) from error


def load_panda_py() -> ModuleType:
    """Return the module panda_py.

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


def connection_problem(library: Any, address: str, error: BaseException) -> BackendError:
    """Say what the failure to connect means and what to do."""
    if isinstance(error, library.IncompatibleVersionError):
        wanted = getattr(error, "libfranka_version", None) or "see the message"
        return BackendError(
            f"the robot at {address} speaks another protocol: {error}",
            hint=f"install panda-python for libfranka {wanted} (docs/tutorials/own_robot.md)",
        )
    text = str(error)
    if "FCI" in text:
        return BackendError(
            f"the robot at {address} is on, but its FCI is off: {text}",
            hint="unlock the joints and activate FCI in Desk; it is off after every start",
        )
    return BackendError(
        f"cannot reach the robot at {address}: {text}",
        hint=f"ping {address}; is the control unit on, the cable in its LAN port, and "
        "panda.robot_ip right?",
    )


def named_errors(errors: Any) -> list[str]:
    """Return the names of the libfranka errors that are set."""
    return [n for n in dir(errors) if not n.startswith("_") and getattr(errors, n) is True]


def explained(text: str) -> str:
    """Append the remedy for the first libfranka error that the text names."""
    for name, remedy in _REMEDIES.items():
        if name in text:
            return f"{text}; {remedy}"
    return f"{text}; look at the robot, then call arm/recover"


def is_lost(error: BaseException) -> bool:
    """Return whether an error of the library says that the connection is gone."""
    lowered = str(error).lower()
    return isinstance(error, RuntimeError) and any(words in lowered for words in _NETWORK)
