"""Collision-free joint paths: RRT-Connect to the easiest of several goals, then short-cutting.

Bounded by a number of growing steps, not by time: the same seed gives the same path everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from flowbothd_common.types import Array
from franka_suction_driver.arm.limits import PositionBox

EdgeFree = Callable[[Array, Array], bool]
_STEP = 0.5
"""Longest edge of a tree [rad]."""


@dataclass(frozen=True)
class FoundPath:
    """A collision-free joint path.

    Attributes:
        points: (P, J) corners, straight in between, P >= 2.
        goal: Index of the goal that it reaches.
        iterations: Growing steps that it took; 0 = the straight way was free.
    """

    points: Array
    goal: int
    iterations: int


class _Tree:
    """Configurations with their parents; roots have parent -1."""

    def __init__(self, roots: Array) -> None:
        capacity = max(64, 2 * len(roots))
        self._points: Array = np.empty((capacity, roots.shape[1]))
        self._points[: len(roots)] = roots
        self._parents = [-1] * len(roots)

    def __len__(self) -> int:
        return len(self._parents)

    def point(self, index: int) -> Array:
        return np.asarray(self._points[index])

    def nearest(self, q: Array) -> int:
        offsets = self._points[: len(self)] - q
        return int(np.argmin(np.einsum("ij,ij->i", offsets, offsets)))

    def add(self, q: Array, parent: int) -> int:
        if len(self) == len(self._points):
            self._points = np.concatenate([self._points, np.empty_like(self._points)])
        self._points[len(self)] = q
        self._parents.append(parent)
        return len(self) - 1

    def branch(self, index: int) -> tuple[list[Array], int]:
        """Points from `index` to its root, and the root's index."""
        points = []
        root = index
        while index >= 0:
            points.append(self._points[index].copy())
            root = index
            index = self._parents[index]
        return points, root


def find_path(
    start: Array,
    goals: Array,
    box: PositionBox,
    free: Callable[[Array], bool],
    edge_free: EdgeFree,
    rng: np.random.Generator,
    max_iterations: int,
) -> FoundPath | None:
    """A path from `start` to one of the `goals`, all of which must be free, or None.

    The straight ways are tried first, in the order of the goals.

    Args:
        start: (J,) [rad].
        goals: (G, J) in order of preference.
        box: Where to search.
        free: Whether a configuration is free.
        edge_free: Whether the straight motion between two free configurations is free.
        rng: Source of all randomness.
        max_iterations: Growing steps before giving up.
    """
    for index, goal in enumerate(goals):
        if edge_free(start, goal):
            return FoundPath(np.array([start, goal]), index, 0)
    here, there = _Tree(start[None]), _Tree(goals)
    growing_from_start = True
    for iteration in range(1, max_iterations + 1):
        tree, other = (here, there) if growing_from_start else (there, here)
        target = box.sample(rng, 1)[0]
        new = _extend(tree, target, free, edge_free)
        if new is not None:
            met = _connect(other, tree.point(new), free, edge_free)
            if met is not None:
                first, second = (new, met) if growing_from_start else (met, new)
                return _joined(here, there, first, second, iteration)
        growing_from_start = not growing_from_start
    return None


def shorten(points: Array, edge_free: EdgeFree, rng: np.random.Generator, attempts: int) -> Array:
    """(P, J) path with detours cut out by straight motions between random points of it."""
    corners = [np.asarray(p) for p in points]
    for _ in range(attempts):
        if len(corners) < 3:
            break
        lengths = np.array([_length(a, b) for a, b in pairwise(corners)])
        first, second = np.sort(rng.uniform(0.0, lengths.sum(), 2))
        i, a = _along(corners, lengths, first)
        j, b = _along(corners, lengths, second)
        if i == j or not edge_free(a, b):
            continue
        corners = [*corners[: i + 1], a, b, *corners[j + 1 :]]
    return _without_needless(corners, edge_free)


def _length(a: Array, b: Array) -> float:
    return float(np.linalg.norm(b - a))


def _along(corners: list[Array], lengths: Array, distance: float) -> tuple[int, Array]:
    """Index of the segment at `distance` along the path, and the point there."""
    ends = np.cumsum(lengths)
    k = min(int(np.searchsorted(ends, distance)), len(lengths) - 1)
    part = (distance - (ends[k] - lengths[k])) / max(float(lengths[k]), 1e-12)
    return k, corners[k] + (corners[k + 1] - corners[k]) * min(1.0, max(0.0, part))


def _without_needless(corners: list[Array], edge_free: EdgeFree) -> Array:
    """Drop corners that can be passed straight, farthest leaps first."""
    kept = [corners[0]]
    k = 0
    while k < len(corners) - 1:
        leap = len(corners) - 1
        while leap > k + 1 and not edge_free(corners[k], corners[leap]):
            leap -= 1
        kept.append(corners[leap])
        k = leap
    return np.array(kept)


def _extend(
    tree: _Tree, target: Array, free: Callable[[Array], bool], edge_free: EdgeFree
) -> int | None:
    nearest = tree.nearest(target)
    origin = tree.point(nearest)
    distance = _length(origin, target)
    q = target if distance <= _STEP else origin + (target - origin) * (_STEP / distance)
    if not free(q) or not edge_free(origin, q):
        return None
    return tree.add(q, nearest)


def _connect(
    tree: _Tree, target: Array, free: Callable[[Array], bool], edge_free: EdgeFree
) -> int | None:
    """Grow towards `target` as far as possible; the index of the node that reaches it, or None."""
    while True:
        new = _extend(tree, target, free, edge_free)
        if new is None:
            return None
        if _length(tree.point(new), target) < 1e-9:
            return new


def _joined(here: _Tree, there: _Tree, first: int, second: int, iteration: int) -> FoundPath:
    to_start, _ = here.branch(first)
    to_goal, root = there.branch(second)
    return FoundPath(np.array(to_start[::-1] + to_goal[1:]), root, iteration)
