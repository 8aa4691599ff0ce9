"""The audit log: every commanded motion as one line of JSON, in files that rotate."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from flowbothd_common.errors import ParameterError
from flowbothd_common.motion import JointTrajectory, MotionGoal, MotionResult

_KEPT = 10
"""Rotated files that are kept."""
_DIGITS = 5
"""Decimals of positions, speeds and times: 10 micrometres."""


class AuditSink(Protocol):
    """Takes in what happened."""

    def write(self, event: str, time: float, entry: Mapping[str, Any]) -> None:
        """Keep one event.

        Args:
            event: goal, trajectory, result, halt or clear_stop.
            time: Node clock [s].
            entry: What JSON can hold.
        """
        ...


class NoAudit:
    """Keeps nothing."""

    def write(self, event: str, time: float, entry: Mapping[str, Any]) -> None:
        """Forget it."""


class AuditLog:
    """Appends JSON lines to a file, which is rotated by size; ten old ones are kept.

    Args:
        path: The file; its folder is made.
        max_bytes: Size at which the next file begins.

    Raises:
        ParameterError: the file cannot be written.
    """

    def __init__(self, path: Path, max_bytes: int) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._handler = RotatingFileHandler(
                path, maxBytes=max_bytes, backupCount=_KEPT, encoding="utf-8"
            )
        except OSError as error:
            raise ParameterError(
                f"the audit log cannot be written: {error}",
                got=str(path),
                hint="set safety.audit_log to a file that this user may write, or to nothing",
            ) from error
        self._handler.setFormatter(logging.Formatter("%(message)s"))

    def write(self, event: str, time: float, entry: Mapping[str, Any]) -> None:
        """Append one event."""
        line = json.dumps({"event": event, "time": round(time, 6), **entry})
        record = logging.LogRecord("audit", logging.INFO, "", 0, line, None, None)
        self._handler.emit(record)

    def close(self) -> None:
        """Close the file."""
        self._handler.close()


def goal_entry(goal: MotionGoal) -> dict[str, Any]:
    """A goal for the log."""
    return {
        "motion": goal.kind.value,
        "contact": _numbers(goal.contact),
        "direction": _numbers(goal.direction),
        "distance": goal.distance,
    }


def trajectory_entry(trajectory: JointTrajectory, *, shown: bool = False) -> dict[str, Any]:
    """A trajectory for the log: where it leads, how long and how fast."""
    return {
        "duration": round(float(trajectory.times[-1]), _DIGITS),
        "points": len(trajectory.times),
        "first": _numbers(trajectory.positions[0]),
        "last": _numbers(trajectory.positions[-1]),
        "peak_velocity": _numbers(np.abs(trajectory.velocities).max(axis=0)),
        "sent": not shown,
    }


def result_entry(result: MotionResult) -> dict[str, Any]:
    """A result for the log."""
    return {
        "motion": result.kind.value,
        "reason": result.reason.value,
        "message": result.message,
        "reached_fraction": round(result.reached_fraction, _DIGITS),
        "tool_start": _numbers(result.tool_start[:3, 3]),
        "tool_end": _numbers(result.tool_end[:3, 3]),
        "peak_force": round(float(np.linalg.norm(result.peak_wrench[:3])), 2),
        "vacuum": bool(result.vacuum),
    }


def _numbers(values: Any) -> list[float] | None:
    return None if values is None else np.round(np.asarray(values, float), _DIGITS).tolist()
