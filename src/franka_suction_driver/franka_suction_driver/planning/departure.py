"""Departure from a contact: the first part of a retreat.

Pairs that touch at the start may keep touching until the arm is free of them; no other pair may
begin to touch.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from flowbothd_common.types import Array
from franka_suction_driver.planning.collision import CLOUD, HIDDEN, CollisionChecker, ContactPair
from franka_suction_driver.planning.opening_path import MOVING_PART

TOOL_LINKS = ("suction_stem", "suction_cup")
"""Links of the tool that come within the margin of what the cup touches."""
_CLOSE = 0.002
"""Distance that counts as contact once the tip has left [m]: the tip would drag the
part along."""
_SEARCHED = np.linspace(0.02, 0.6, 30)
"""Fractions of the way to a configuration beyond, where a free one is looked for [-]: steps of 2 %,
and no further than 60 %, because the path search takes over from a free configuration."""


class Departure:
    """Judge a path out of a contact, configuration by configuration.

    Within the margins only pairs that touch at the start may keep touching, and the tool's tip
    what it has touched. Within `_CLOSE` not even the tip may come back once it has left.

    Args:
        checker: Robot and scene.
        start: (J,) where the path begins.
    """

    def __init__(self, checker: CollisionChecker, start: Array) -> None:
        tool = {
            ContactPair(link, thing)
            for link in TOOL_LINKS
            for thing in (CLOUD, HIDDEN, MOVING_PART)
        }
        self._checker = checker
        self._excused = checker.touches(start) | tool
        self._close = self._closely(start)

    def allows(self, q: Array) -> bool:
        """Return True if the path may go on to joint positions (J,); to be called in order."""
        if not self._checker.touches(q) <= self._excused:
            return False
        close = self._closely(q)
        if not close <= self._close:
            return False
        self._close = close
        return True

    def _closely(self, q: Array) -> frozenset[ContactPair]:
        with self._checker.with_scene_margin(min(_CLOSE, self._checker.scene_margin)):
            touches = self._checker.touches(q)
        return frozenset(touch for touch in touches if touch.second != HIDDEN)


def escape(
    checker: CollisionChecker, back: Array, beyond: Iterable[Array]
) -> tuple[Array, Array | None]:
    """Return the way out of a contact and the free configuration at its end, None if there is none.

    Args:
        checker: Robot and scene.
        back: (K, J) straight back along the tool, from where the arm stands.
        beyond: Configurations to go on towards where backing off alone does not come free.
    """
    departure = Departure(checker, back[0])
    count = 1
    while count < len(back) and departure.allows(back[count]):
        count += 1
    back = back[:count]
    free = [k for k, q in enumerate(back) if checker.free(q)]
    if free:
        return back[: free[-1] + 1], back[free[-1]]
    for goal in beyond:
        departure = Departure(checker, back[-1])
        for part in _SEARCHED:
            q = back[-1] + (goal - back[-1]) * part
            if checker.free(q):
                return np.vstack([back, q]), q
            if not departure.allows(q):
                break
    return back, None


def leaves_and_stays_free(checker: CollisionChecker, path: Array) -> bool:
    """Return True if a (K, J) path touches only at its beginning, and only what may be touched."""
    departure = Departure(checker, path[0])
    gone = False
    for q in path:
        if checker.free(q):
            gone = True
        elif gone or not departure.allows(q):
            return False
    return True
