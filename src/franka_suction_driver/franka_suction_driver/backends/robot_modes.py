"""The states that a Panda reports, and the documented way out of each."""

from __future__ import annotations

from collections.abc import Sequence

from franka_suction_driver.backends.library import explained

USER_STOP = "the user stop is pressed: release it, then call arm/recover"
GUIDING = "the robot is being guided by hand: let go of the buttons, then call arm/recover"
_RECOVERING = "the robot is recovering from an error: wait until it is done, then call arm/recover"
_MOVED = (
    "the robot is moved by another program: end that program, since only one may use the FCI, "
    "then call arm/recover"
)
_OTHER = (
    "the robot is neither idle nor in an error (joints locked, or a self-test is due or runs): "
    "unlock the joints in Desk and finish the self-test, then call arm/recover"
)
_BY_MODE = {
    "kUserStopped": USER_STOP,
    "kGuiding": GUIDING,
    "kAutomaticErrorRecovery": _RECOVERING,
}
_CLEARABLE = ("kReflex", "kIdle", "kMove", "kOther")


def problem(mode: str, errors: Sequence[str], *, controlled: bool) -> str:
    """Say what keeps the robot from following commands and how to go on, or nothing.

    Args:
        mode: Name of libfranka's RobotMode.
        errors: Names of the errors that are set now.
        controlled: A controller of ours runs, so that moving is as it should be.
    """
    if mode in _BY_MODE:
        return _BY_MODE[mode]
    if errors or mode == "kReflex":
        return explained(f"the robot is in {mode} {' '.join(errors)}".strip())
    if mode == "kIdle" or (mode == "kMove" and controlled):
        return ""
    if mode == "kMove":
        return _MOVED
    return _OTHER


def clearable(mode: str, errors: Sequence[str]) -> bool:
    """Return whether libfranka's automatic error recovery is the documented remedy.

    It is for a reflex and for errors. A user stop, guiding, and locked joints end only by hand.
    """
    return mode == "kReflex" or (bool(errors) and mode in _CLEARABLE)
