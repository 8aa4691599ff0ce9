"""Where the tool will have to go after the contact: the opening as a path of tool poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flowbothd_common.transforms import rotation_about
from flowbothd_common.types import ArcKind, Array, JointArc

_PROBE_POSES = 4


@dataclass(frozen=True)
class ToolPoses:
    """A path of tool poses, from the standoff over the contact along the opening.

    Attributes:
        positions: (K, 3) tip positions in base [m].
        axes: (K, 3) unit directions of the tool's z axis in base.
        contact: Index of the pose at the contact.
    """

    positions: Array
    axes: Array
    contact: int


def opening_poses(
    contact: Array,
    direction: Array,
    side: int,
    standoff: float,
    travel: float,
    arc: JointArc | None,
    *,
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
        arc: How the part moves; a straight line along `direction` if unknown.
        tilt_slack: How far the tool's axis may stay behind the flow's turn [rad].
        spacing: Distance between two poses along the opening [m].
    """
    axis = -side * direction
    distances = np.linspace(standoff, 0.0, _PROBE_POSES)
    positions = [contact - axis * d for d in distances]
    axes = [axis] * len(positions)
    count = max(1, int(np.ceil(travel / spacing))) if travel > 0 else 0
    for k in range(1, count + 1):
        way = travel * k / count
        if arc is None or arc.kind is ArcKind.LINE:
            positions.append(contact + direction * way)
            axes.append(axis)
            continue
        arm = contact - arc.point
        radius = float(np.linalg.norm(arm - arc.axis * (arm @ arc.axis)))
        sign = 1.0 if np.cross(arc.axis, arm) @ direction >= 0 else -1.0
        angle = way / max(radius, 1e-3)
        turned = rotation_about(arc.axis, sign * angle)
        behind = rotation_about(arc.axis, sign * max(0.0, angle - tilt_slack))
        positions.append(arc.point + turned @ arm)
        axes.append(behind @ axis)
    return ToolPoses(np.array(positions), np.array(axes), _PROBE_POSES - 1)
