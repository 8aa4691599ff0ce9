"""The cup seals, pulls, reports and lets go as a cup would."""

import numpy as np
import pytest

from flowbothd_common.transforms import apply, inverse, rotation_about, transform
from sim_bridge.suction_cup import CupParams, SuctionCup, SurfaceHit

DT = 1 / 240
FULL = 60_000.0


class Plate:
    """A square plate in the plane z = 0 of its own frame, facing +z; body 3, link 5."""

    def __init__(self, half=0.1):
        self.half = half
        self.pose = np.eye(4)
        self.velocity = np.zeros(3)

    def cast(self, starts, ends):
        back = inverse(self.pose)
        found = []
        for start, end in zip(apply(back, starts), apply(back, ends), strict=True):
            if (start[2] > 0) == (end[2] > 0):
                found.append(None)
                continue
            point = start + (end - start) * start[2] / (start[2] - end[2])
            inside = np.abs(point[:2]).max() <= self.half
            normal = self.pose[:3, 2]
            found.append(SurfaceHit(3, 5, apply(self.pose, point), normal) if inside else None)
        return found

    def link_pose(self, body, link):
        assert (body, link) == (3, 5)
        return self.pose

    def point_velocity(self, body, link, point):
        return self.velocity


def tip_at(gap, x=0.0, tilt_deg=0.0):
    """A tip that looks down at the plate."""
    down = rotation_about((1, 0, 0), np.pi) @ rotation_about((0, 1, 0), np.deg2rad(tilt_deg))
    return transform(down, (x, 0.0, gap))


def attached(plate, **kwargs):
    cup = SuctionCup(CupParams(**kwargs))
    cup.command(FULL)
    run(cup, plate, tip_at(0.0), 0.2)
    assert cup.attached
    return cup


def run(cup, plate, tip, seconds, velocity=(0, 0, 0)):
    force = None
    for _ in range(round(seconds / DT)):
        force = cup.step(DT, tip, np.array(velocity, dtype=float), plate)
    return force


@pytest.mark.parametrize(
    ("tip", "seals"),
    [
        (tip_at(0.002), True),
        (tip_at(-0.002), True),
        (tip_at(0.005), False),
        (tip_at(0.001, tilt_deg=20), True),
        (tip_at(0.001, tilt_deg=28), False),
        (tip_at(0.001, x=0.084), True),
        (tip_at(0.001, x=0.092), False),
        (tip_at(0.001, x=0.12), False),
    ],
)
def test_it_seals_near_flat_and_with_its_whole_rim(tip, seals):
    cup = SuctionCup()
    cup.command(FULL)
    run(cup, Plate(), tip, 0.1)
    assert cup.attached == seals


def test_without_vacuum_nothing_seals_and_nothing_is_measured():
    cup = SuctionCup()
    run(cup, Plate(), tip_at(0.0), 0.1)
    assert not cup.attached
    assert cup.reading().vacuum == 0.0


def test_the_vacuum_builds_up_and_the_flag_follows_it():
    cup, plate = SuctionCup(), Plate()
    cup.command(FULL)
    run(cup, plate, tip_at(0.05), 0.3)
    free = cup.reading()
    assert 0 < free.vacuum < 0.15 * FULL
    assert not free.part_present
    cup.step(DT, tip_at(0.0), np.zeros(3), plate)
    assert cup.attached
    assert not cup.reading().part_present, "vacuum takes its time"
    run(cup, plate, tip_at(0.0), 0.2)
    assert cup.reading().part_present
    assert cup.reading().vacuum == pytest.approx(FULL, rel=0.01)


def test_it_seals_without_force_and_then_pulls_like_a_spring():
    plate = Plate()
    cup = SuctionCup()
    cup.command(FULL)
    first = cup.step(DT, tip_at(0.002), np.zeros(3), plate)
    assert np.allclose(first.force_on_tool, 0.0)
    lifted = run(cup, plate, tip_at(0.007), 0.1)
    # 5 mm at 3 N/mm, downwards on the tool.
    assert np.allclose(lifted.force_on_tool, (0, 0, -15.0), atol=1e-9)
    assert (lifted.body, lifted.link) == (3, 5)
    assert cup.tension == pytest.approx(15.0, rel=0.02)
    assert cup.shear == pytest.approx(0.0, abs=1e-9)


def test_the_anchor_travels_with_the_part():
    plate = Plate()
    cup = attached(plate)
    plate.pose = transform(translation=(0.004, 0.0, 0.0))
    force = run(cup, plate, tip_at(0.0), 0.1)
    assert np.allclose(force.force_on_tool, (12.0, 0, 0), atol=1e-9)
    assert cup.shear == pytest.approx(12.0, rel=0.02)


def test_damping_opposes_the_relative_motion():
    plate = Plate()
    cup = attached(plate)
    force = cup.step(DT, tip_at(0.0), np.array([0, 0, 0.1]), plate)
    assert force.force_on_tool[2] == pytest.approx(-2.5)


@pytest.mark.parametrize(
    ("tip", "word"),
    [
        (tip_at(0.0145), "pulled off"),
        (tip_at(0.0, x=0.0115), "sheared off"),
        (tip_at(0.0, tilt_deg=33), "peeled off"),
    ],
)
def test_it_comes_off_by_pull_shear_or_peel_and_says_so(tip, word):
    plate = Plate()
    cup = attached(plate)
    run(cup, plate, tip, 0.2)
    assert not cup.attached
    assert word in cup.loss_reason
    reading = cup.reading()
    assert reading.part_detached
    assert not reading.part_present


@pytest.mark.parametrize("tip", [tip_at(0.0125), tip_at(0.0, x=0.010), tip_at(0.0, tilt_deg=28)])
def test_just_below_its_limits_it_holds(tip):
    plate = Plate()
    cup = attached(plate)
    run(cup, plate, tip, 0.5)
    assert cup.attached


def test_pressing_never_breaks_the_seal():
    plate = Plate()
    cup = attached(plate)
    force = run(cup, plate, tip_at(-0.03), 0.5)
    assert cup.attached
    assert force.force_on_tool[2] == pytest.approx(90.0)


def test_a_short_peak_is_filtered_out():
    plate = Plate()
    cup = attached(plate)
    cup.step(DT, tip_at(0.02), np.zeros(3), plate)
    run(cup, plate, tip_at(0.0), 0.2)
    assert cup.attached


def test_there_is_a_moment_of_grace_after_sealing():
    plate = Plate()
    cup = SuctionCup()
    cup.command(FULL)
    cup.step(DT, tip_at(0.0), np.zeros(3), plate)
    run(cup, plate, tip_at(0.02), 0.13)
    assert cup.attached
    run(cup, plate, tip_at(0.02), 0.05)
    assert not cup.attached


def test_a_weaker_vacuum_holds_less():
    plate = Plate()
    cup = SuctionCup()
    cup.command(FULL / 3)
    run(cup, plate, tip_at(0.0), 0.2)
    run(cup, plate, tip_at(0.006), 0.2)
    assert not cup.attached, "18 N are more than a third of 40 N"


def test_what_came_off_stays_off_until_the_pump_has_been_off():
    plate = Plate()
    cup = attached(plate)
    run(cup, plate, tip_at(0.02), 0.3)
    run(cup, plate, tip_at(0.0), 0.3)
    assert not cup.attached
    assert cup.reading().part_detached
    cup.command(0.0)
    assert not cup.reading().part_detached
    cup.command(FULL)
    run(cup, plate, tip_at(0.0), 0.3)
    assert cup.attached


def test_switching_off_lets_go_and_vents():
    plate = Plate()
    cup = attached(plate)
    cup.command(0.0)
    assert not cup.attached
    run(cup, plate, tip_at(0.01), 0.3)
    assert cup.reading().vacuum < 100.0
    assert not cup.reading().part_detached


def test_a_dry_cup_pushes_but_does_not_pull():
    plate, cup = Plate(), SuctionCup()
    force = run(cup, plate, tip_at(-0.002), 0.05)
    assert force.force_on_tool[2] == pytest.approx(6.0)
    assert run(cup, plate, tip_at(0.001), 0.05) is None
    leaving = run(cup, plate, tip_at(-0.0005), 0.01, velocity=(0, 0, 0.5))
    assert leaving.force_on_tool[2] == 0.0


@pytest.mark.parametrize("bad", [-1.0, float("nan"), float("inf")])
def test_a_vacuum_that_makes_no_sense_is_refused(bad):
    with pytest.raises(ValueError, match=">= 0 Pa"):
        SuctionCup().command(bad)
