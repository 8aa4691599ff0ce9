"""Goals checked and turned into geometry: which way to travel, where the tool shall point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flowbothd_common.errors import MotionRejectedError
from flowbothd_common.motion import MotionGoal, MotionKind
from flowbothd_common.transforms import angle_between, rotation_about, unit
from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import TipState
from franka_suction_driver.execution.tool_reference import ToolLine

_LONGEST = 0.5
"""Longest motion that a goal may ask for [m]: anything longer is a mistake of units."""
_ASIDE = np.radians(60.0)
"""Largest angle between a probe's direction and the tool's axis [rad]: farther off, the cup touches
with its side."""


def checked_goal(goal: MotionGoal) -> MotionGoal:
    """The goal with a unit direction.

    Raises:
        MotionRejectedError: a part is missing, not finite, or out of range; it says which.
    """
    name = goal.kind.value
    if not (np.isfinite(goal.distance) and 0.0 <= goal.distance <= _LONGEST):
        raise MotionRejectedError(
            f"distance of {name}", got=goal.distance, allowed=f"0 <= distance <= {_LONGEST} m"
        )
    if goal.kind is MotionKind.RETREAT:
        return goal
    if goal.kind is MotionKind.APPROACH:
        if goal.contact is None or not np.isfinite(goal.contact).all():
            raise MotionRejectedError(
                f"{name} needs a contact point", got=goal.contact, allowed="3 finite numbers [m]"
            )
        goal = replace(goal, contact=np.asarray(goal.contact, dtype=float))
    try:
        direction = unit(np.zeros(3) if goal.direction is None else goal.direction)
    except ValueError as error:
        raise MotionRejectedError(
            f"{name} needs a direction", got=goal.direction, allowed="a vector with a length"
        ) from error
    return replace(goal, direction=direction)


def travel_direction(axis: Array, direction: Array) -> Array:
    """Direction in which a probe travels: as asked, but always towards where the tool points.

    After an approach from the opposite side the asked direction leads away from the object; the
    side of the approach is kept.

    Raises:
        MotionRejectedError: the direction is neither along nor against the tool.
    """
    angle = angle_between(axis, direction)
    if angle <= _ASIDE:
        return direction
    if angle >= np.pi - _ASIDE:
        return -direction
    raise MotionRejectedError(
        "the probe's direction is across the tool",
        got=f"{np.degrees(angle):.0f} degrees from its axis",
        allowed="within 60 degrees of the axis, either way",
        hint="approach along this direction first",
    )


def led_axes(axis: Array, direction: Array, lead: float, max_lead: float) -> list[Array]:
    """Tool axes (3,) to try for the end of a flow step, the best first.

    The arm may be able to turn less than it should: after the turn ahead of the flow come the
    flow itself and half the way to it.
    """
    led = led_axis(axis, direction, lead, max_lead)
    aligned = led_axis(axis, direction, 0.0, 0.0)
    angle = angle_between(axis, aligned)
    if angle < 1e-6:
        return [led]
    half = rotation_about(np.cross(axis, aligned), angle / 2) @ axis
    return [led, aligned, np.asarray(half)]


def lagging_axis(axis: Array, direction: Array, lag: float) -> Array:
    """(3,) axis of a pushing tool at the end of a step: as it is, or at `lag` [rad] behind.

    Args:
        axis: (3,) present tool axis.
        direction: (3,) unit flow at the end of the step.
        lag: Largest tilt against it [rad].
    """
    angle = angle_between(axis, direction)
    if angle <= lag:
        return axis
    return np.asarray(rotation_about(np.cross(direction, axis), lag) @ direction)


def led_axis(axis: Array, direction: Array, lead: float, max_lead: float) -> Array:
    """(3,) tool axis at the end of a flow step.

    Against the flow, or along it if the tool stands on the other side; turned further by `lead`
    times the turn since the last step, since the part will go on turning within the step.

    Args:
        axis: (3,) present tool axis.
        direction: (3,) unit flow.
        lead: Part of the turn.
        max_lead: Bound on the extra turn [rad].
    """
    aligned = -direction if float(axis @ direction) < 0 else direction
    angle = angle_between(axis, aligned)
    if angle < 1e-6:
        return np.asarray(aligned)
    extra = min(max_lead, lead * angle)
    return np.asarray(rotation_about(np.cross(axis, aligned), extra) @ aligned)


def tool_line(
    tip: TipState, direction: Array, length: float, axis_end: Array, turn_length: float
) -> ToolLine:
    """A straight motion from where the tip is."""
    return ToolLine(tip.position, direction, length, tip.axis, axis_end, turn_length)
