"""Boxes, buckets, pots, kettles, bins and toilets: things with lids."""

from __future__ import annotations

import numpy as np

from flowbothd_model.data.articulated import ArticulatedObject
from flowbothd_model.data.procedural.builder import Builder


def box(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A box with one lid, or with two or four flaps."""
    builder = Builder(rng)
    width, depth, height = (float(rng.uniform(*r)) for r in ((0.3, 1.0), (0.25, 0.8), (0.12, 0.7)))
    wall = float(rng.uniform(0.008, 0.03))
    half_x, half_y = depth / 2, width / 2
    builder.shell(builder.body, (-half_x, -half_y, 0), (half_x, half_y, height), wall, "top")
    flaps = int(rng.choice([1, 2, 4], p=[0.5, 0.25, 0.25]))
    top, upper = height + wall, float(rng.uniform(1.5, 3.0))
    if flaps == 1:
        lip = float(rng.uniform(0.0, 0.4)) * height
        back = rng.random() < 0.8
        lid = builder.hinge(
            (half_x if back else -half_x, 0, height), (0, 1 if back else -1, 0), min(upper, 2.2)
        )
        builder.box(lid, (-half_x, -half_y, height), (half_x, half_y, top))
        if lip > 0.1 * height:
            builder.shell(
                lid,
                (-half_x - wall, -half_y - wall, height - lip),
                (half_x + wall, half_y + wall, top),
                wall,
                "bottom",
            )
        if rng.random() < 0.3:
            builder.handle(lid, (-half_x - wall, 0, height), 0.2 * width, False)
        return builder.finish(name, "Box")
    across = rng.random() < 0.5
    if (flaps == 2 and not across) or flaps == 4:
        for sign in (-1.0, 1.0):
            lid = builder.hinge((0, sign * half_y, height), (-sign, 0, 0), upper)
            inner = 0.0 if flaps == 2 else sign * half_y * float(rng.uniform(0.3, 0.7))
            ends = sorted((inner, sign * half_y))
            builder.box(lid, (-half_x, ends[0], height), (half_x, ends[1], height + wall / 2))
    if (flaps == 2 and across) or flaps == 4:
        base = height + (wall / 2 if flaps == 4 else 0.0)
        for sign in (-1.0, 1.0):
            lid = builder.hinge((sign * half_x, 0, base), (0, sign, 0), upper)
            ends = sorted((0.0, sign * half_x))
            builder.box(lid, (ends[0], -half_y, base), (ends[1], half_y, base + wall / 2))
    return builder.finish(name, "Box")


def _vessel(
    builder: Builder, radius: float, height: float, flare: float, wall: float, belly: float = 0.0
) -> None:
    """An open pot: outside and inside walls with a floor."""
    middle = radius * (1 + flare / 2 + belly)
    profile = [(0.0, 0.0), (radius, 0.0), (middle, height / 2), (radius * (1 + flare), height)]
    inside = [(r - wall, max(h, wall)) for r, h in reversed(profile[1:])]
    builder.turned(builder.body, (0, 0, 0), (0, 0, 1), [*profile, *inside, (0.0, wall)], 24)


def bucket(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A bucket whose bow handle turns about the line through its ears."""
    builder = Builder(rng)
    radius, height = float(rng.uniform(0.12, 0.25)), float(rng.uniform(0.2, 0.5))
    flare = float(rng.uniform(0.0, 0.5))
    _vessel(builder, radius, height, flare, 0.012)
    rim, z = radius * (1 + flare) + 0.006, height * float(rng.uniform(0.85, 1.0))
    sign = float(rng.choice([-1.0, 1.0]))
    # Closed = lying at one side of the rim; it opens over the top.
    handle = builder.hinge((0, 0, z), (0, sign, 0), float(rng.uniform(1.5, 3.0)))
    builder.arc(
        handle, (0, 0, z), (0, rim, z), (0, 0, sign), np.pi, float(rng.uniform(0.005, 0.012)), 14
    )
    if rng.random() < 0.3:
        builder.rod(handle, (-sign * rim, -0.06, z), (-sign * rim, 0.06, z), 0.02, 8)
    return builder.finish(name, "Bucket")


def _lid(builder: Builder, link: int, radius: float, z: float) -> None:
    """A round lid with a knob or a bow."""
    rng = builder.rng
    dome = radius * float(rng.uniform(0.05, 0.35))
    knob = radius * float(rng.uniform(0.08, 0.2))
    builder.turned(
        link, (0, 0, z), (0, 0, 1),
        [(0.0, 0.0), (radius, 0.0), (radius, 0.04 * radius), (0.5 * radius, 0.8 * dome),
         (0.4 * knob, dome), (0.4 * knob, dome + 0.6 * knob), (knob, dome + knob),
         (knob, dome + 1.6 * knob), (0.0, dome + 1.8 * knob)], 20,
    )  # fmt: skip


def kitchen_pot(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A pot with a lid that lifts (sometimes hinges), and one long or two short handles."""
    builder = Builder(rng)
    radius, height = float(rng.uniform(0.1, 0.25)), float(rng.uniform(0.06, 0.3))
    _vessel(builder, radius, height, float(rng.uniform(-0.05, 0.2)), 0.006)
    rim = radius * 1.15
    if rng.random() < 0.85:
        lid = builder.slide((0, 0, 1), height * float(rng.uniform(0.5, 1.2)))
    else:
        lid = builder.hinge((rim, 0, height), (0, 1, 0), 1.5)
    _lid(builder, lid, rim, height)
    z = height * 0.8
    if rng.random() < 0.3:
        builder.rod(
            builder.body, (0, radius, z), (0, radius * 3, z + 0.1 * radius), 0.08 * radius, 8
        )
    else:
        for sign in (-1.0, 1.0):
            center = np.array([0, sign * radius, z])
            builder.arc(
                builder.body,
                center,
                center + np.array([0.3 * radius, 0.0, 0.0]),
                (0, 0, sign),
                np.pi,
                0.05 * radius,
                6,
            )
    return builder.finish(name, "KitchenPot")


def kettle(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A kettle: spout, handle, and a lid that lifts or hinges."""
    builder = Builder(rng)
    radius, height = float(rng.uniform(0.07, 0.14)), float(rng.uniform(0.1, 0.28))
    neck = radius * float(rng.uniform(0.45, 0.9))
    belly = radius * float(rng.uniform(1.0, 1.2))
    builder.turned(
        builder.body,
        (0, 0, 0),
        (0, 0, 1),
        [(0, 0), (radius, 0), (belly, 0.4 * height), (neck, height), (0, height)],
        24,
    )
    side = float(rng.choice([-1.0, 1.0]))
    builder.rod(
        builder.body,
        (0, side * 0.8 * belly, 0.55 * height),
        (0, side * 1.8 * radius, height * float(rng.uniform(0.8, 1.1))),
        0.18 * radius,
        8,
    )
    if rng.random() < 0.7:
        builder.arc(
            builder.body,
            (0, -side * 0.9 * radius, 0.55 * height),
            (0, -side * 0.9 * radius, 0.95 * height),
            (side, 0, 0),
            np.pi,
            0.1 * radius,
            8,
        )
    else:
        top = height * 1.05
        builder.arc(
            builder.body, (0, 0, top), (0, radius, top), (1, 0, 0), np.pi, 0.08 * radius, 10
        )
    if rng.random() < 0.7:
        lid = builder.slide((0, 0, 1), height * float(rng.uniform(0.3, 0.8)))
    else:
        lid = builder.hinge((0, -side * neck, height), (side, 0, 0), float(rng.uniform(1.0, 1.8)))
    _lid(builder, lid, neck, height)
    return builder.finish(name, "Kettle")


def trash_can(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A bin with a hinged lid, a lid that lifts off, or a swinging flap; sometimes a pedal."""
    builder = Builder(rng)
    height, half = float(rng.uniform(0.3, 0.9)), float(rng.uniform(0.12, 0.28))
    slim = half * float(rng.uniform(0.7, 1.2))
    round_body = rng.random() < 0.5
    back = rng.random() < 0.75
    hinge_point = (half if back else 0.0, 0 if back else slim, height)
    upper = float(rng.uniform(1.1, 1.9))
    if rng.random() < 0.8:
        lid = builder.hinge(hinge_point, (0, 1, 0) if back else (-1, 0, 0), upper)
    else:
        lid = builder.slide((0, 0, 1), half)
    thick = half * float(rng.uniform(0.08, 0.5))
    if round_body:
        _vessel(builder, half, height, 0.0, 0.01)
        builder.turned(
            lid,
            (0, 0, height),
            (0, 0, 1),
            [(0, 0), (half, 0), (half, 0.3 * thick), (0.6 * half, thick), (0, thick)],
            20,
        )
    else:
        builder.shell(builder.body, (-half, -slim, 0), (half, slim, height), 0.01, "top")
        builder.box(lid, (-half, -slim, height), (half, slim, height + thick))
    if rng.random() < 0.4:
        pedal = builder.hinge((-half + 0.04, 0, 0.04), (0, -1, 0), 0.3)
        builder.box(pedal, (-half - 0.07, -0.25 * slim, 0.02), (-half + 0.02, 0.25 * slim, 0.04))
    return builder.finish(name, "TrashCan")


def toilet(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A bowl with seat and lid hinged at its back, a tank and a flush lever or button."""
    builder = Builder(rng)
    half, length, height = (
        float(rng.uniform(*r)) for r in ((0.16, 0.22), (0.4, 0.55), (0.36, 0.46))
    )
    builder.turned(
        builder.body,
        (0, 0, 0),
        (0, 0, 1),
        [
            (0.6 * half, 0),
            (0.5 * half, 0.4 * height),
            (half * 1.05, height),
            (half * 0.8, height),
            (0.4 * half, 0.5 * height),
            (0, 0.5 * height),
        ],
        20,
    )
    x1 = half * 1.1
    tank = float(rng.uniform(0.25, 0.5))
    builder.box(
        builder.body, (x1, -half * 1.1, height * 0.9), (x1 + 0.2, half * 1.1, height + tank)
    )
    builder.box(builder.body, (0, -0.5 * half, 0), (x1 + 0.1, 0.5 * half, height * 0.95))
    x0 = x1 - length
    upper = float(rng.uniform(1.4, 1.75))
    thick = 0.02
    if rng.random() < 0.8:
        seat = builder.hinge((x1, 0, height), (0, 1, 0), upper)
        bar = 0.3 * half
        builder.box(seat, (x0, -half, height), (x1, -half + bar, height + thick))
        builder.box(seat, (x0, half - bar, height), (x1, half, height + thick))
        builder.box(seat, (x0, -half, height), (x0 + bar, half, height + thick))
    lid = builder.hinge((x1, 0, height + thick), (0, 1, 0), upper)
    builder.box(lid, (x0, -half, height + thick), (x1, half, height + 2 * thick))
    if rng.random() < 0.5:
        y, z = half * 0.7, height + tank * 0.85
        lever = builder.hinge((x1, y, z), (1, 0, 0), 0.6)
        builder.box(lever, (x1 - 0.03, y - 0.08, z - 0.01), (x1, y + 0.01, z + 0.01))
    elif rng.random() < 0.5:
        button = builder.slide((0, 0, -1), 0.01)
        z = height + tank
        builder.rod(button, (x1 + 0.1, 0, z), (x1 + 0.1, 0, z + 0.012), 0.03, 10)
    return builder.finish(name, "Toilet")
