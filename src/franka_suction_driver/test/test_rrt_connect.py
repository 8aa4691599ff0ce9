"""Path search in a plane, where what is free can be seen."""

from __future__ import annotations

import itertools

import numpy as np

from franka_suction_driver.arm.limits import PositionBox
from franka_suction_driver.planning.rrt_connect import find_path, shorten

BOX = PositionBox(np.array([-3.0, -3.0]), np.array([3.0, 3.0]))
START, GOAL = np.array([-2.0, 0.0]), np.array([2.0, 0.0])


def free(q: np.ndarray) -> bool:
    """A wall at x = 0 with a gap above y = 2."""
    return not (abs(q[0]) < 0.2 and q[1] < 2.0)


def edge_free(a: np.ndarray, b: np.ndarray) -> bool:
    count = max(2, int(np.linalg.norm(b - a) / 0.02))
    return all(free(a + (b - a) * t) for t in np.linspace(0, 1, count))


def search(seed: int, iterations: int = 2000, goals: np.ndarray = GOAL[None]):
    rng = np.random.default_rng(seed)
    return find_path(START, goals, BOX, free, edge_free, rng, iterations)


def test_paths_lead_around_the_wall() -> None:
    for seed in range(10):
        path = search(seed)
        assert path is not None
        np.testing.assert_array_equal(path.points[0], START)
        np.testing.assert_array_equal(path.points[-1], GOAL)
        corners = list(path.points)
        assert all(edge_free(a, b) for a, b in itertools.pairwise(corners))


def test_equal_seeds_give_equal_paths() -> None:
    first, second = search(3), search(3)
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first.points, second.points)


def test_the_straight_way_is_taken_and_the_first_such_goal_wins() -> None:
    goals = np.array([GOAL, [-2.0, 1.0], [-1.0, 0.0]])
    path = search(0, goals=goals)
    assert path is not None
    assert (path.goal, path.iterations, len(path.points)) == (1, 0, 2)


def test_no_way_is_told_within_the_bound() -> None:
    rng = np.random.default_rng(0)
    asked = []

    def walled(q: np.ndarray) -> bool:
        asked.append(q)
        return abs(q[0]) > 0.2

    def edge(a: np.ndarray, b: np.ndarray) -> bool:
        return a[0] * b[0] > 0 and walled(a) and walled(b)

    assert find_path(START, GOAL[None], BOX, walled, edge, rng, 50) is None
    assert len(asked) < 50 * 40


def test_shortening_keeps_ends_and_freedom() -> None:
    detour = np.array([START, [-2.5, 2.5], [-1, 2.9], [0, 2.5], [1, 2.9], [2.8, 2.0], GOAL])
    rng = np.random.default_rng(0)
    short = shorten(detour, edge_free, rng, 200)

    def length(points: np.ndarray) -> float:
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    np.testing.assert_array_equal(short[[0, -1]], detour[[0, -1]])
    assert length(short) < 0.8 * length(detour)
    corners = list(short)
    assert all(edge_free(a, b) for a, b in itertools.pairwise(corners))
