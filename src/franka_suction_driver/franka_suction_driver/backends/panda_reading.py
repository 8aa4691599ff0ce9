"""One state as libfranka reports it, checked before anything is decided from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flowbothd_common.types import Array
from franka_suction_driver.backends.library import RAISED, named_errors
from franka_suction_driver.backends.protocol import BackendError

_CHECK = "restart the robot; if it comes again, its sensors or panda-python are at fault"


class UnusableStateError(BackendError):
    """The robot's joint positions or velocities are no numbers that could be used."""


@dataclass(frozen=True)
class PandaReading:
    """What a RobotState says.

    Attributes:
        q: (7,) measured joint positions, finite [rad].
        dq: (7,) measured joint velocities, finite [rad/s].
        wrench: (6,) O_F_ext_hat_K, finite; None where it cannot be used.
        end: (4, 4) O_T_EE, finite; None where it cannot be used.
        stiffness: (3,) origin of frame K in base, finite [m]; None where it cannot be used.
        mode: Name of the RobotMode.
        errors: Names of the errors that are set now.
        time: The robot's own clock [s]; advances with every new state.
        trouble: Empty, or which of the values cannot be used.
    """

    q: Array
    dq: Array
    wrench: Array | None
    end: Array | None
    stiffness: Array | None
    mode: str
    errors: tuple[str, ...]
    time: float
    trouble: str = ""


def reading_of(seen: Any) -> PandaReading:
    """Check a RobotState and take out what this project uses.

    Raises:
        UnusableStateError: q or dq are incomplete or not finite, or mode and time are missing.
    """
    unusable: list[str] = []
    wrench = _finite(seen, "O_F_ext_hat_K", 6, unusable)
    end = _pose(seen, "O_T_EE", unusable)
    stiffness_in_end = _pose(seen, "EE_T_K", unusable)
    stiffness = None
    if end is not None and stiffness_in_end is not None:
        stiffness = (end @ stiffness_in_end)[:3, 3]
    lacking: list[str] = []
    q, dq = _finite(seen, "q", 7, lacking), _finite(seen, "dq", 7, lacking)
    if q is None or dq is None:
        raise UnusableStateError(
            "the robot reports joint states that cannot be used",
            got=", ".join(lacking),
            hint=_CHECK,
        )
    try:
        mode = str(seen.robot_mode).rpartition(".")[2]
        errors = tuple(named_errors(seen.current_errors))
        time = float(seen.time.to_sec())
    except (AttributeError, *RAISED) as error:
        raise UnusableStateError(
            "the robot's state lacks mode, errors or time", got=str(error), hint=_CHECK
        ) from error
    trouble = ""
    if unusable:
        trouble = f"the robot reports values that cannot be used: {', '.join(unusable)}; {_CHECK}"
    return PandaReading(q, dq, wrench, end, stiffness, mode, errors, time, trouble)


def _finite(seen: Any, name: str, size: int, unusable: list[str]) -> Array | None:
    """Take a vector of `size` finite numbers; otherwise note what it is and return None."""
    try:
        values = np.array(getattr(seen, name), dtype=float)
    except (AttributeError, *RAISED) as error:
        unusable.append(f"{name} ({error})")
        return None
    if values.shape != (size,):
        unusable.append(f"{name} has the shape {values.shape}, needed is ({size},)")
        return None
    if not np.isfinite(values).all():
        unusable.append(f"{name} = {np.round(values, 3).tolist()}")
        return None
    return values


def _pose(seen: Any, name: str, unusable: list[str]) -> Array | None:
    columns = _finite(seen, name, 16, unusable)
    return None if columns is None else columns.reshape(4, 4).T
