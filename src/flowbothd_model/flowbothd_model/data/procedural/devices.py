"""Laptops, phones, staplers, switches and folding chairs."""

from __future__ import annotations

import numpy as np

from flowbothd_model.data.articulated import ArticulatedObject
from flowbothd_model.data.procedural.builder import Builder


def laptop(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A base and a screen hinged at its back."""
    builder = Builder(rng)
    width, depth = float(rng.uniform(0.25, 0.42)), float(rng.uniform(0.18, 0.3))
    base, screen = float(rng.uniform(0.01, 0.035)), float(rng.uniform(0.005, 0.018))
    builder.box(builder.body, (-depth / 2, -width / 2, 0), (depth / 2, width / 2, base))
    if rng.random() < 0.6:
        builder.box(
            builder.body,
            (-0.1 * depth, -0.4 * width, base),
            (0.35 * depth, 0.4 * width, base + 0.002),
        )
    gap = 0.003
    back = depth / 2 - (0.0 if rng.random() < 0.6 else 0.05 * depth)
    lid = builder.hinge((back, 0, base + gap / 2), (0, 1, 0), float(rng.uniform(1.6, 2.6)))
    builder.box(lid, (-depth / 2, -width / 2, base + gap), (back, width / 2, base + gap + screen))
    if rng.random() < 0.4:
        builder.rod(lid, (back, -0.35 * width, base), (back, 0.35 * width, base), 0.012, 8)
    return builder.finish(name, "Laptop")


def phone(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A flip phone, a slider, or a receiver on its base; keys that press in."""
    builder = Builder(rng)
    width, length, thick = (
        float(rng.uniform(*r)) for r in ((0.04, 0.07), (0.08, 0.14), (0.008, 0.016))
    )
    builder.box(builder.body, (-length / 2, -width / 2, 0), (length / 2, width / 2, thick))
    style = float(rng.random())
    if style < 0.5:
        lid = builder.hinge((length / 2, 0, thick), (0, 1, 0), float(rng.uniform(1.8, 2.9)))
        builder.box(lid, (-length / 2, -width / 2, thick), (length / 2, width / 2, thick * 1.8))
        builder.rod(
            lid, (length / 2, -0.4 * width, thick), (length / 2, 0.4 * width, thick), 0.5 * thick, 8
        )
    elif style < 0.8:
        lid = builder.slide((1, 0, 0), length * float(rng.uniform(0.35, 0.6)))
        builder.box(lid, (-length / 2, -width / 2, thick), (length / 2, width / 2, thick * 1.7))
    else:
        for sign in (-1.0, 1.0):
            builder.box(
                builder.body,
                (sign * 0.35 * length - 0.01, -width / 2, thick),
                (sign * 0.35 * length + 0.01, width / 2, thick * 1.6),
            )
        lid = builder.slide((0, 0, 1), length * 0.5)
        z = thick * 1.9
        builder.rod(lid, (-0.45 * length, 0, z), (0.45 * length, 0, z), 0.2 * width, 10)
        for sign in (-1.0, 1.0):
            builder.rod(
                lid,
                (sign * 0.38 * length, 0, z - 0.2 * width),
                (sign * 0.38 * length, 0, z + 0.1 * width),
                0.3 * width,
                10,
            )
    if rng.random() < 0.3:
        key = builder.slide((0, 1, 0), 0.002)
        builder.box(
            key, (0, -width / 2 - 0.003, 0.2 * thick), (0.15 * length, -width / 2, 0.7 * thick)
        )
    return builder.finish(name, "Phone")


def stapler(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A base plate and an arm hinged at one end, sometimes with a magazine between them."""
    builder = Builder(rng)
    length, width, height = (
        float(rng.uniform(*r)) for r in ((0.1, 0.2), (0.025, 0.05), (0.03, 0.08))
    )
    base = 0.25 * height
    builder.box(builder.body, (-length / 2, -width / 2, 0), (length / 2, width / 2, base))
    post = float(rng.uniform(0.1, 0.2)) * length
    builder.box(
        builder.body,
        (length / 2 - post, -0.5 * width, base),
        (length / 2, 0.5 * width, 0.6 * height),
    )
    pivot = (length / 2 - post / 2, 0, 0.55 * height)
    reach = float(rng.uniform(0.85, 1.05)) * length
    tip = length / 2 - reach
    low = 0.5 * height
    if rng.random() < 0.5:
        magazine = builder.hinge(pivot, (0, 1, 0), float(rng.uniform(0.4, 1.2)))
        builder.box(
            magazine,
            (tip + 0.02, -0.3 * width, low),
            (length / 2 - post, 0.3 * width, 0.7 * height),
        )
        arm = builder.hinge(pivot, (0, 1, 0), float(rng.uniform(0.3, 1.0)), magazine)
        low = 0.72 * height
    else:
        arm = builder.hinge(pivot, (0, 1, 0), float(rng.uniform(0.4, 2.4)))
    builder.box(arm, (tip, -0.42 * width, low), (length / 2, 0.42 * width, height))
    if rng.random() < 0.4:
        builder.rod(
            arm,
            (tip, -0.42 * width, low + 0.1 * height),
            (tip, 0.42 * width, low + 0.1 * height),
            0.12 * height,
            10,
        )
    return builder.finish(name, "Stapler")


def switch(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A wall plate with rockers, levers, knobs or sliders."""
    builder = Builder(rng)
    count = int(rng.integers(1, 4))
    cell, height, thick = (
        float(rng.uniform(*r)) for r in ((0.06, 0.1), (0.09, 0.15), (0.006, 0.02))
    )
    width = cell * count
    builder.box(builder.body, (0, -width / 2, 0), (thick, width / 2, height))
    style = str(rng.choice(["rocker", "lever", "knob", "slider"]))
    for k in range(count):
        y, z = -width / 2 + (k + 0.5) * cell, height / 2
        half = cell * float(rng.uniform(0.15, 0.3))
        tall = height * float(rng.uniform(0.2, 0.35))
        up = float(rng.choice([-1.0, 1.0]))
        if style == "rocker":
            link = builder.hinge((0, y, z), (0, up, 0), float(rng.uniform(0.2, 0.5)))
            builder.box(link, (-0.5 * thick, y - half, z - tall), (0, y + half, z + tall))
        elif style == "lever":
            link = builder.hinge((0, y, z), (0, up, 0), float(rng.uniform(0.5, 1.2)))
            end = np.array([-0.25 * height, y, z - up * 0.1 * height])
            builder.rod(link, (0, y, z), end, 0.2 * half, 8)
            builder.rod(link, end, end + np.array([-0.02, 0.0, 0.0]), 0.3 * half, 8)
        elif style == "knob":
            link = builder.hinge((0, y, z), (1, 0, 0), float(rng.uniform(1.5, 5.0)))
            builder.rod(link, (0, y, z), (-0.3 * cell, y, z), half, 14)
            builder.box(
                link,
                (-0.4 * cell, y - 0.1 * half, z - half),
                (-0.3 * cell, y + 0.1 * half, z + half),
            )
        else:
            link = builder.slide((0, 0, 1), 1.2 * tall)
            builder.box(link, (-0.15 * cell, y - half, z - tall), (0, y + half, z - 0.4 * tall))
    return builder.finish(name, "Switch")


def folding_chair(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A chair whose seat folds against the back; closed = folded."""
    builder = Builder(rng)
    width, height = float(rng.uniform(0.38, 0.5)), float(rng.uniform(0.75, 1.0))
    seat_height, seat_depth = (
        height * float(rng.uniform(0.42, 0.55)),
        float(rng.uniform(0.32, 0.45)),
    )
    bar, half = float(rng.uniform(0.01, 0.02)), width / 2
    for sign in (-1.0, 1.0):
        builder.rod(builder.body, (0, sign * half, 0), (0, sign * half, height), bar, 8)
    builder.box(builder.body, (-bar, -half, height * 0.75), (bar, half, height))
    builder.rod(builder.body, (0, -half, 0.15 * height), (0, half, 0.15 * height), bar, 8)
    inner = half - 2.5 * bar
    up = rng.random() < 0.6
    # Folded upwards along the back, or hanging down; it opens to the level.
    seat = builder.hinge(
        (-2 * bar, 0, seat_height), (0, -1 if up else 1, 0), float(rng.uniform(1.3, 1.7))
    )
    ends = (
        (seat_height, seat_height + seat_depth) if up else (seat_height - seat_depth, seat_height)
    )
    builder.box(seat, (-3.5 * bar, -inner, ends[0]), (-1.5 * bar, inner, ends[1]))
    legs = builder.hinge((2 * bar, 0, seat_height), (0, 1, 0), float(rng.uniform(0.4, 0.8)))
    for sign in (-1.0, 1.0):
        builder.rod(
            legs, (2.5 * bar, sign * inner, 0.02), (2.5 * bar, sign * inner, seat_height), bar, 8
        )
    builder.rod(legs, (2.5 * bar, -inner, 0.2 * height), (2.5 * bar, inner, 0.2 * height), bar, 8)
    return builder.finish(name, "FoldingChair")
