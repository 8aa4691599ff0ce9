"""Opening judged by the tool's path."""

from itertools import pairwise

import numpy as np
import pytest

from flowbothd_common.transforms import angle_between
from flowbothd_common.types import JointEstimate, JointKind
from flowbothd_policy.opening import Travel, expected_joint, fit_path, judge_opening
from flowbothd_policy.params import OpeningParams
from flowbothd_policy.screw import Screw

PARAMS = OpeningParams()


def arc_points(radius, angles, centre=(0.5, 0.1, 0.3)):
    return [np.array(centre) + radius * np.array([np.cos(a), np.sin(a), 0]) for a in angles]


def travel_along(points, screw=None, travel=None):
    travel = (travel or Travel()).begun()
    for a, b in pairwise(points):
        travel = travel.extended(a, b - a, screw)
    return travel


def hinge(radius, point=(0.5, 0.1, 0.0)):
    return Screw(
        JointEstimate(JointKind.REVOLUTE, np.array([0, 0, 1.0]), np.array(point)),
        1 / radius,
        0.0,
        99,
    )


def test_circle_through_a_path():
    fit = fit_path(tuple(arc_points(0.2, np.radians([10, 30, 50, 70]))))
    assert fit.radius == pytest.approx(0.2)
    np.testing.assert_allclose(fit.joint.point[:2], (0.5, 0.1), atol=1e-9)
    assert angle_between(fit.joint.axis, (0, 0, 1)) < 1e-6
    backwards = fit_path(tuple(arc_points(0.2, np.radians([70, 50, 30, 10]))))
    assert angle_between(backwards.joint.axis, (0, 0, -1)) < 1e-6
    assert fit_path(tuple(arc_points(0.2, [0, 1]))) is None


def test_angle_from_the_path_alone():
    opening = judge_opening(travel_along(arc_points(0.2, np.radians([0, 20, 40, 60]))), PARAMS)
    assert opening.kind is JointKind.REVOLUTE
    assert np.degrees(opening.amount) == pytest.approx(60, abs=0.1)
    assert opening.share == pytest.approx(60 / 66, rel=1e-2)
    assert opening.remaining() == pytest.approx(0.2 * np.radians(6), rel=0.05)


def test_one_step_needs_the_prediction():
    points = arc_points(0.15, np.radians([0, 19]))
    assert judge_opening(travel_along(points), PARAMS).kind is JointKind.PRISMATIC
    hinted = judge_opening(travel_along(points, hinge(0.15)), PARAMS)
    assert np.degrees(hinted.amount) == pytest.approx(19, abs=0.1)


def test_a_straight_path_overrules_a_predicted_hinge():
    points = [np.array([0.5 - 0.05 * k, 0.0, 0.3]) for k in range(5)]
    opening = judge_opening(travel_along(points, hinge(0.15, (0.5, 0.15, 0))), PARAMS)
    assert opening.kind is JointKind.PRISMATIC
    assert opening.share == pytest.approx(0.2 / PARAMS.target_distance)


def test_angles_add_up_over_grasps():
    travel = travel_along(arc_points(0.2, np.radians([0, 15, 30])), hinge(0.2))
    travel = travel_along(arc_points(0.1, np.radians([30, 45, 60])), hinge(0.1), travel)
    assert np.degrees(judge_opening(travel, PARAMS).amount) == pytest.approx(60, abs=1)


def test_nothing_moved_is_nothing_opened():
    opening = judge_opening(Travel().begun().begun(), PARAMS)
    assert opening.share == 0
    assert opening.remaining() == float("inf")


def test_the_path_tells_the_arc_once_it_bends():
    travel = travel_along(arc_points(0.2, np.radians([0, 15, 30, 45])), hinge(0.5))
    assert expected_joint(travel, hinge(0.5), PARAMS).point[1] == pytest.approx(0.1)
    assert expected_joint(Travel(), hinge(0.5), PARAMS) is not None
    assert expected_joint(Travel(), None, PARAMS) is None


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_the_path_is_tolerated(seed):
    rng = np.random.default_rng(seed)
    points = [
        p + rng.normal(scale=0.001, size=3) for p in arc_points(0.15, np.radians([0, 19, 38, 57]))
    ]
    opening = judge_opening(travel_along(points, hinge(0.16)), PARAMS)
    assert np.degrees(opening.amount) == pytest.approx(57, abs=6)


def pulled(points, travel, screw):
    """Travel of one more grasp whose first pull is tangential."""
    travel = travel.begun()
    for a, b in pairwise(points):
        tangent = np.cross((0, 0, 1.0), a - np.array((0.5, 0.1, 0.3)))
        travel = travel.extended(a, b - a, screw, tangent / np.linalg.norm(tangent))
    return travel


@pytest.mark.parametrize(("resumed_at", "total"), [(40, 60), (0, 20), (35, 60), (65, 85)])
def test_what_the_part_did_while_it_was_not_held_counts(resumed_at, total):
    """A lid and a door moved while they were let go.

    The lid shut itself from 42 degrees, and the next 28 counted as 70; the door swung open from
    35 degrees, and was thought to be half open to the end.
    """
    first = arc_points(0.2, np.radians([0, 15, 30, 40]))
    again = arc_points(0.2, np.radians([resumed_at, resumed_at + 10, resumed_at + 20]))
    travel = pulled(again, pulled(first, Travel(), hinge(0.2)), hinge(0.2))
    assert np.degrees(judge_opening(travel, PARAMS).amount) == pytest.approx(total, abs=1)


def test_a_pull_at_the_end_of_the_joint_tells_how_far_it_is():
    travel = pulled(arc_points(0.2, np.radians([0, 15, 30])), Travel(), hinge(0.2))
    tangent = np.array([-np.sin(np.radians(68)), np.cos(np.radians(68)), 0])
    swung_on = travel.begun().tried(arc_points(0.2, [np.radians(68)])[0], tangent)
    assert judge_opening(swung_on, PARAMS).share > 1
    assert judge_opening(travel.begun(), PARAMS).share < 0.5
    wrong_first = Travel().begun().tried(np.zeros(3), np.array([1.0, 0, 0]))
    assert judge_opening(wrong_first, PARAMS).share == 0
