"""Leaving a contact: the first part of a retreat, from inside the margins to a free configuration.

What touches at the start may go on touching until the arm is free of it; nothing else may begin
to.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from flowbothd_common.types import Array
from franka_suction_driver.collision import CLOUD, HIDDEN, CollisionChecker, Touch

TOOL_LINKS = ("suction_stem", "suction_cup")
"""Parts of the tool that come within the margin of what the cup touches."""


@dataclass(frozen=True)
class Excuses:
    """What may touch while a contact is left.

    Attributes:
        touches: Pairs that touch at the start, and the tool's tip with what it has touched.
    """

    touches: frozenset[Touch]

    @staticmethod
    def at(checker: CollisionChecker, q: Array) -> Excuses:
        """Excuse what touches at joint positions (J,)."""
        tool = {Touch(link, thing) for link in TOOL_LINKS for thing in (CLOUD, HIDDEN)}
        return Excuses(frozenset(checker.touches(q) | tool))

    def cover(self, checker: CollisionChecker, q: Array) -> bool:
        """Whether nothing touches at joint positions (J,) but what is excused."""
        return checker.touches(q) <= self.touches


def escape(
    checker: CollisionChecker, back: Array, beyond: Iterable[Array]
) -> tuple[Array, Array | None]:
    """The way out of a contact, and the free configuration at its end; None if there is none.

    Args:
        checker: Robot and scene.
        back: (K, J) straight back along the tool, from where the arm stands.
        beyond: Configurations to go on towards where backing off alone does not come free.
    """
    excuses = Excuses.at(checker, back[0])
    allowed = [excuses.cover(checker, q) for q in back]
    if not all(allowed):
        back = back[: max(1, allowed.index(False))]
    free = [k for k, q in enumerate(back) if checker.free(q)]
    if free:
        return back[: free[-1] + 1], back[free[-1]]
    for goal in beyond:
        for part in np.linspace(0.02, 0.6, 30):
            q = back[-1] + (goal - back[-1]) * part
            if checker.free(q):
                return np.vstack([back, q]), q
            if not excuses.cover(checker, q):
                break
    return back, None


def leaves_and_stays_free(checker: CollisionChecker, path: Array) -> bool:
    """Whether a (K, J) path only touches, at its beginning, what is excused there."""
    excuses = Excuses.at(checker, path[0])
    leaving = True
    for q in path:
        if checker.free(q):
            leaving = False
        elif not leaving or not excuses.cover(checker, q):
            return False
    return True
