"""What comes after the contact: the opening as a path of tool poses, and the part that swings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeGuard

import numpy as np

from flowbothd_common.transforms import rotation_about, transform
from flowbothd_common.types import Array, Cloud, JointEstimate, JointKind
from franka_suction_driver.planning.collision import Box

MOVING_PART = "the moving part"
_PROBE_POSES = 4
"""Poses from the standoff to the contact."""
_BACK_OFF_POSES = 3
"""Poses of backing off after the opening."""
_PLATE = 0.02
"""Thickness of a swinging part [m]: a furniture panel."""
_BEYOND = 0.03
"""Least way that a part reaches beyond the contact, away from its axis [m]: the cup's radius of 15
mm, twice."""
_MOST_BEYOND = 0.15
"""Farthest from the contact that points are still taken for the part [m]."""
_MOST_TURN = 0.25
"""Largest turn of the tool between two checked poses [rad]."""
_GAP = 0.025
"""Gap between observed points at which the part ends [m]: wider than the cells of the cloud,
narrower than the gap to a neighbouring door."""
_NEAR_PLATE = 0.03
"""Distance from the part's plane within which points belong to it [m]: handles and noise."""
_DEFAULT_HALF_HEIGHT = 0.1
"""Half height of a part of which no point was observed [m]."""


@dataclass(frozen=True)
class ToolPoses:
    """A path of tool poses: from the standoff over the contact along the opening, and back off.

    Attributes:
        positions: (K, 3) tip positions in base [m].
        axes: (K, 3) unit directions of the tool's z axis in base.
        part: (K, 4, 4) displacement of the moving part in base at each pose.
        contact: Index of the pose at the contact.
        opened: Index of the pose at the end of the opening.
    """

    positions: Array
    axes: Array
    part: Array
    contact: int
    opened: int


def opening_poses(
    contact: Array,
    direction: Array,
    side: int,
    standoff: float,
    travel: float,
    joint: JointEstimate | None,
    *,
    tilt: Array | None = None,
    back_off: float = 0.0,
    tilt_slack: float = 0.0,
    spacing: float = 0.02,
) -> ToolPoses:
    """Tool poses of a whole opening.

    Args:
        contact: (3,) in base [m].
        direction: (3,) unit flow at the contact.
        side: +1 = the tool stands on the side the part moves to and pulls, -1 = opposite.
        standoff: Distance of the first pose from the contact [m].
        travel: Length of the opening along the path of the contact [m].
        joint: How the part moves; a straight line along `direction` if unknown.
        tilt: (3, 3) turn of the tool's axis away from the flow's; none if omitted.
        back_off: Way straight back along the tool at the end [m].
        tilt_slack: How far the tool's axis may stay behind the flow's turn [rad].
        spacing: Largest distance between two poses along the opening [m].
    """
    straight = -side * direction
    axis = straight if tilt is None else tilt @ straight
    positions = [contact - straight * d for d in np.linspace(standoff, 0.0, _PROBE_POSES)]
    axes = [axis] * _PROBE_POSES
    part = [np.eye(4)] * _PROBE_POSES
    if swings(joint, contact):
        # Near a hinge a short way turns the tool a lot.
        spacing = min(spacing, _MOST_TURN * float(np.linalg.norm(_radial(contact, joint))))
    count = max(1, int(np.ceil(travel / spacing))) if travel > 0 else 0
    for way in np.linspace(0.0, travel, count + 1)[1:]:
        moved = displacement(contact, direction, joint, float(way))
        lagging = displacement(contact, direction, joint, float(way), behind=tilt_slack)
        positions.append(moved[:3, :3] @ contact + moved[:3, 3])
        axes.append(lagging[:3, :3] @ axis)
        part.append(moved)
    last = _PROBE_POSES - 1 + count
    # Whoever opens has to get away again.
    for way in np.linspace(0.0, back_off, _BACK_OFF_POSES + 1)[1:] if back_off > 0 else ():
        positions.append(positions[last] - axes[last] * way)
        axes.append(axes[last])
        part.append(part[last])
    return ToolPoses(np.array(positions), np.array(axes), np.array(part), last - count, last)


def displacement(
    contact: Array,
    direction: Array,
    joint: JointEstimate | None,
    way: float,
    *,
    behind: float = 0.0,
) -> Array:
    """(4, 4) how the part has moved in base after `way` [m] at the contact.

    Args:
        contact: (3,) in base [m].
        direction: (3,) unit flow at the contact; tells the sense of the arc.
        joint: How the part moves; a straight line if unknown.
        way: Length along the path of the contact [m].
        behind: Angle by which an arc's rotation stays behind [rad].
    """
    if joint is None or joint.kind is JointKind.PRISMATIC:
        return transform(translation=direction * way)
    radial = _radial(contact, joint)
    sense = 1.0 if float(np.cross(joint.axis, radial) @ direction) >= 0 else -1.0
    angle = max(0.0, way / max(float(np.linalg.norm(radial)), 1e-3) - behind)
    rotation = rotation_about(joint.axis, sense * angle)
    return transform(rotation, joint.point - rotation @ joint.point)


@dataclass(frozen=True)
class PlateExtent:
    """How far a swinging plate reaches from the place where it is held [m].

    Attributes:
        low: Along its axis, against it; negative.
        high: Along its axis.
        beyond: Away from the axis.
    """

    low: float = -_DEFAULT_HALF_HEIGHT
    high: float = _DEFAULT_HALF_HEIGHT
    beyond: float = _BEYOND


def plate_extent(
    contact: Array, direction: Array, joint: JointEstimate, cloud: Cloud | None
) -> PlateExtent:
    """The extent by the observed points in the plate's plane, as far as they hang together.

    Args:
        contact: (3,) in base [m].
        direction: (3,) unit flow at the contact.
        joint: How the part moves, about an axis.
        cloud: (N, 3) observed points in base, or None.
    """
    outward, normal, radius = _plate_axes(contact, direction, joint)
    if cloud is None:
        return PlateExtent()
    offsets = cloud - contact
    flat = np.abs(offsets @ normal) < _NEAR_PLATE
    across = offsets @ outward
    near = flat & (across > -radius) & (across < _BEYOND)
    if not near.any():
        return PlateExtent()
    heights = offsets[near] @ joint.axis
    outer = np.sort(across[flat & (across > 0) & (across < _MOST_BEYOND)])
    gaps = np.flatnonzero(np.diff(outer, prepend=0.0) > _GAP)
    edge = outer[: gaps[0]] if len(gaps) else outer
    beyond = float(edge[-1]) if len(edge) else 0.0
    return PlateExtent(float(heights.min()), float(heights.max()), max(beyond, _BEYOND))


def moving_part(
    contact: Array, direction: Array, side: int, joint: JointEstimate | None, extent: PlateExtent
) -> Box | None:
    """The swinging part as a plate from its axis over the contact, or None if it does not swing.

    Args:
        contact: (3,) in base [m].
        direction: (3,) unit flow at the contact.
        side: +1 = the tool stands on the side the part moves to.
        joint: How the part moves.
        extent: How far the plate reaches.
    """
    if not swings(joint, contact):
        return None
    outward, normal, radius = _plate_axes(contact, direction, joint)
    low, high, beyond = extent.low, extent.high, extent.beyond
    size = (radius + beyond, _PLATE, max(high - low, _PLATE))
    centre = (
        contact
        + outward * (beyond - radius) / 2
        - normal * side * _PLATE / 2
        + joint.axis * (low + high) / 2
    )
    # The third axis only carries the height, which is centred: its sign does not matter.
    rotation = np.column_stack([outward, normal, np.cross(outward, normal)])
    return Box(MOVING_PART, size, transform(rotation, centre))


def swings(joint: JointEstimate | None, contact: Array) -> TypeGuard[JointEstimate]:
    """Whether a part swings about an axis that is not right at the contact."""
    if joint is None or joint.kind is not JointKind.REVOLUTE:
        return False
    return float(np.linalg.norm(_radial(contact, joint))) >= _PLATE


def _plate_axes(
    contact: Array, direction: Array, joint: JointEstimate
) -> tuple[Array, Array, float]:
    """Way out from the axis, normal on the side of the flow, and distance from the axis."""
    radial = _radial(contact, joint)
    radius = float(np.linalg.norm(radial))
    outward = radial / radius
    normal = np.cross(joint.axis, outward)
    if float(normal @ direction) < 0:
        normal = -normal
    return outward, normal, radius


def _radial(contact: Array, joint: JointEstimate) -> Array:
    """(3,) from the axis to the contact, square to the axis."""
    arm = contact - joint.point
    return np.asarray(arm - joint.axis * float(arm @ joint.axis))
