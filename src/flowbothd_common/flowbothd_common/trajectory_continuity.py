"""Continuity of a new trajectory with the commanded state of the arm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flowbothd_common.types import Array


def discontinuity(
    names: Sequence[str],
    start: tuple[Array, Array],
    first: tuple[Array, Array],
    lead: float,
    *,
    tolerance: float,
    acceleration: Array | float,
) -> str:
    """Return why a trajectory does not continue the commanded state; empty if it does.

    A controller joins its commanded state to the first point whatever lies between. An arm that
    was held while the reference ran on would snap after it.

    From its start, no motion within an acceleration a ends further than a t^2 / 4 from where the
    mean of its first and last velocity leads; so no motion within the limits is ever refused.

    Args:
        names: J joints, for the message.
        start: Commanded position and velocity, (J,) each [rad, rad/s].
        first: Position and velocity of the first point ahead, (J,) each.
        lead: Time between both [s], 0 or more.
        tolerance: Accepted on top [rad].
        acceleration: Of each joint, at most [rad/s^2].
    """
    reached = start[0] + 0.5 * lead * (start[1] + first[1])
    off = np.abs(first[0] - reached)
    excess = off - tolerance - 0.25 * np.asarray(acceleration) * lead**2
    worst = int(np.argmax(excess))
    if excess[worst] <= 0:
        return ""
    return (
        f"{names[worst]} would leap by {off[worst]:.3f} rad to its first point: the trajectory "
        "begins elsewhere than the arm is; plan from where it stands"
    )
