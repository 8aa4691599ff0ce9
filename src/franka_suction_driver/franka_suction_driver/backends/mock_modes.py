"""States and refusals of libfranka 0.9.2, for the stand-in."""

from __future__ import annotations

from enum import Enum
from typing import Any

ERRORS = ("cartesian_reflex", "joint_reflex", "communication_constraints_violation")
RobotMode = Enum(
    "RobotMode", "kOther kIdle kMove kGuiding kReflex kUserStopped kAutomaticErrorRecovery", start=0
)
_NAMES = {
    "kUserStopped": "User stopped",
    "kAutomaticErrorRecovery": "Automatic error recovery",
}
# A read waits so long for a packet [s]; so long does the control loop not notice a pulled cable.
UDP_TIMEOUT = 1.0
UDP_LOST = "libfranka: UDP receive: Timeout"
TCP_LOST = "libfranka: TCP connection got interrupted."
NO_ANSWER = "libfranka: Connection timeout. Please check your network connection or settings."


def rejection(command: str, mode: Any) -> RuntimeError:
    """Return what libfranka raises for a command that the robot does not accept in its mode."""
    name = _NAMES.get(mode.name, mode.name[1:])
    why = f'command not possible in the current mode ("{name}")!'
    if mode is RobotMode.kOther:
        why += " Did you open the brakes?"
    return RuntimeError(f"libfranka: {command} command rejected: {why}")
