"""Openings: the truth about their parts, one run from home to home, records and search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flowbothd_common.errors import ParameterError
from flowbothd_common.transforms import angle_between, apply, inverse
from flowbothd_evaluation.openings.attempt import run_attempt
from flowbothd_evaluation.openings.part import TruePart
from flowbothd_evaluation.openings.runs import Run, make_run, table
from flowbothd_evaluation.openings.search import Place, PlaceSearch
from flowbothd_evaluation.openings.task import key_of, load_openings
from flowbothd_evaluation.openings.views import camera_view
from flowbothd_evaluation.record_files import from_json, to_json
from flowbothd_evaluation.records import OpeningRecord, Seconds, Touch
from sim_bridge.ground_truth import FlowOracle

OPENINGS = load_openings()


@pytest.mark.parametrize("name", OPENINGS)
def test_the_grasp_lies_on_the_part_and_its_flow_is_the_true_one(name: str) -> None:
    opening = OPENINGS[name]
    part, model = TruePart(opening), opening.model()
    contact = part.contact(np.array([0.002, -0.003]))
    oracle = FlowOracle(model)
    pose, closed = opening.T_base_object, model.closed()
    owner = oracle.owners(contact[None].astype(np.float32), pose, closed)[0]
    assert list(model.links)[owner] == model.target.child
    flow = oracle.flow(contact[None], pose, closed, target_only=True).flows[0, 0]
    # Near the hinge of a pushed door the normal stands in for the flow, see TruePart.flow.
    accepted = np.radians(35.0 if opening.front else 2.0)
    assert angle_between(part.flow(contact, 0.0), flow) < accepted
    # Pulled, the part comes towards the face that is held; pushed, it goes away.
    assert (float(part.outward @ flow) < 0) == opening.front


@pytest.mark.parametrize("name", OPENINGS)
def test_a_point_of_the_part_moves_along_its_flow(name: str) -> None:
    opening = replace(OPENINGS[name], front=False)
    part, joint = TruePart(opening), opening.model().target
    start = part.contact(np.zeros(2))
    local = apply(inverse(opening.T_base_object), start)
    for value in (0.3 * opening.goal, 0.8 * opening.goal):
        before, after = (
            apply(opening.T_base_object, apply(joint.motion(v), local))
            for v in (value, value + 1e-5)
        )
        assert angle_between(after - before, part.flow(before, value)) < 1e-3
        assert part.way(before, 1e-5) == pytest.approx(np.linalg.norm(after - before), rel=1e-4)


def test_mirrored_tasks_stand_mirrored() -> None:
    """The arm is symmetric: a place that serves one side serves the other."""
    for left, right in (
        ("pull_left", "pull_right"),
        ("push_right_behind", "push_left_behind"),
        ("push_left_front", "push_right_front"),
        ("cabinet_left", "cabinet_right"),
    ):
        one, other = (TruePart(OPENINGS[n]).contact(np.zeros(2)) for n in (left, right))
        np.testing.assert_allclose(one, other * (1, -1, 1), atol=1e-6)


def test_the_camera_sees_the_held_face() -> None:
    for opening in OPENINGS.values():
        part = TruePart(opening)
        eye, target = camera_view(part)
        assert float((eye - target) @ part.outward) > 0.2


def test_a_grasp_beside_the_part_is_an_error_that_names_the_task() -> None:
    opening = replace(OPENINGS["drawer"], grasp=(0.4, 0.0))
    with pytest.raises(ParameterError, match="drawer"):
        TruePart(opening).contact(np.zeros(2))


def test_an_unknown_task_names_those_that_exist() -> None:
    with pytest.raises(ParameterError, match="pull_left"):
        load_openings(["wardrobe"])


_RUN = OpeningRecord(
    task="lid",
    seed=0,
    at=(),
    reached=1.2,
    left=0.0,
    opened=True,
    clean=True,
    suction_breaks=(),
    touches=(),
    peak_force={"open": 5.0, "probe": 6.0},
    peak_torque={"open": 0.1},
    reasons=(),
    grasp_error=(0.0, 0.0),
    planning_ms={},
    seconds=Seconds(),
)


@pytest.fixture(scope="module")
def drawer() -> OpeningRecord:
    return make_run(Run(OPENINGS["drawer"], 0, None))


@pytest.mark.long
def test_the_drawer_opens_from_its_committed_pose_without_a_touch(drawer: OpeningRecord) -> None:
    assert drawer.opened
    assert drawer.clean, (drawer.suction_breaks, drawer.touches)
    assert drawer.reasons[0] == "approach reached"
    assert drawer.reasons[-1] == "retreat reached"
    assert 0 < drawer.peak_force["open"] < 40
    # It started from home: at the standoff nothing had happened yet.
    assert drawer.peak_force["approach"] == 0
    assert from_json(OpeningRecord, to_json(drawer), "here") == drawer


@pytest.mark.long
def test_equal_seeds_give_equal_runs(drawer: OpeningRecord) -> None:
    again = run_attempt(OPENINGS["drawer"], 0)
    first, again = (replace(r, planning_ms={}, seconds=Seconds()) for r in (drawer, again))
    assert first == again


def test_another_pose_is_another_run() -> None:
    opening = OPENINGS["drawer"]
    moved = opening.standing((0.4, 0.1), opening.yaw, opening.grasp)
    assert key_of(opening, 0) != key_of(moved, 0)
    assert key_of(opening, 0) != key_of(opening, 1)
    at = key_of(opening, 0)[2]
    assert replace(_RUN, task="drawer", at=at).key == key_of(opening, 0)


def test_the_table_counts_runs_that_opened_without_break_or_touch() -> None:
    touch = Touch("suction_body", "lid", "leave", 9.0, 31.0)
    bad = replace(_RUN, seed=1, reached=0.5, opened=False, clean=False, touches=(touch,))
    text = table({"lid": OPENINGS["lid"]}, [_RUN, bad])
    assert "**1 of 2**" in text
    assert "suction_body - lid 1x, 31 N (leave)" in text
    assert "48.7 / 28.6" in text


def test_the_committed_pose_is_reached_with_room_and_a_far_one_is_not() -> None:
    opening = OPENINGS["pull_left"]
    search = PlaceSearch(opening)
    place = search.judge(opening.position, float(np.degrees(opening.yaw)), opening.grasp)
    assert place.reached == 1.0
    assert place.margin > 0.1 and place.clearance > 0
    far = search.judge((0.85, 0.5), 0.0, opening.grasp)
    assert far.reached < 1.0 and far.score < place.score
    on_base = search.judge((0.05, 0.0), 0.0, opening.grasp)
    assert on_base == Place((0.05, 0.0), 0.0, opening.grasp, 0.0)
