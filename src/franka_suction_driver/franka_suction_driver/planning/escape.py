"""Leaving a contact: the first part of a retreat, from inside the margins to a free configuration.

What touches at the start may go on touching until the arm is free of it; nothing else may begin
to.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from flowbothd_common.types import Array
from franka_suction_driver.planning.collision import CLOUD, HIDDEN, CollisionChecker, Touch
from franka_suction_driver.planning.continuation import MOVING_PART

TOOL_LINKS = ("suction_stem", "suction_cup")
"""Parts of the tool that come within the margin of what the cup touches."""


_CLOSE = 0.002


class Leaving:
    """Judges a path out of a contact, configuration by configuration.

    Within the margins only what touches at the start may go on touching, and the tool's tip
    what it has touched. Closer than two millimetres not even the tip may come back once it has
    gone: it would drag the part along.

    Args:
        checker: Robot and scene.
        start: (J,) where the path begins.
    """

    def __init__(self, checker: CollisionChecker, start: Array) -> None:
        tool = {Touch(link, thing) for link in TOOL_LINKS for thing in (CLOUD, HIDDEN, MOVING_PART)}
        self._checker = checker
        self._excused = checker.touches(start) | tool
        self._close = self._closely(start)

    def allows(self, q: Array) -> bool:
        """Whether the path may go on to joint positions (J,); to be asked in order."""
        if not self._checker.touches(q) <= self._excused:
            return False
        close = self._closely(q)
        if not close <= self._close:
            return False
        self._close = close
        return True

    def _closely(self, q: Array) -> frozenset[Touch]:
        usual = self._checker.scene_margin
        self._checker.set_scene_margin(min(_CLOSE, usual))
        touches = self._checker.touches(q)
        self._checker.set_scene_margin(usual)
        return frozenset(touch for touch in touches if touch.second != HIDDEN)


def escape(
    checker: CollisionChecker, back: Array, beyond: Iterable[Array]
) -> tuple[Array, Array | None]:
    """The way out of a contact, and the free configuration at its end; None if there is none.

    Args:
        checker: Robot and scene.
        back: (K, J) straight back along the tool, from where the arm stands.
        beyond: Configurations to go on towards where backing off alone does not come free.
    """
    leaving = Leaving(checker, back[0])
    count = 1
    while count < len(back) and leaving.allows(back[count]):
        count += 1
    back = back[:count]
    free = [k for k, q in enumerate(back) if checker.free(q)]
    if free:
        return back[: free[-1] + 1], back[free[-1]]
    for goal in beyond:
        leaving = Leaving(checker, back[-1])
        for part in np.linspace(0.02, 0.6, 30):
            q = back[-1] + (goal - back[-1]) * part
            if checker.free(q):
                return np.vstack([back, q]), q
            if not leaving.allows(q):
                break
    return back, None


def leaves_and_stays_free(checker: CollisionChecker, path: Array) -> bool:
    """Whether a (K, J) path only touches, at its beginning, what may be touched there."""
    leaving = Leaving(checker, path[0])
    gone = False
    for q in path:
        if checker.free(q):
            gone = True
        elif gone or not leaving.allows(q):
            return False
    return True
