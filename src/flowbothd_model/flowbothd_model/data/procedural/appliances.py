"""Refrigerators, ovens, dishwashers, microwaves, safes and washing machines."""

from __future__ import annotations

import itertools

import numpy as np

from flowbothd_model.data.articulated import ArticulatedObject
from flowbothd_model.data.procedural.builder import Builder
from flowbothd_model.data.procedural.furniture import drawer, hinged_front


def _sizes(rng: np.random.Generator, *ranges: tuple[float, float]) -> list[float]:
    """One uniform number per range."""
    return [float(rng.uniform(low, high)) for low, high in ranges]


def _front(
    depth: float, thick: float, y0: float, y1: float, z0: float, z1: float
) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a door in front of a body of that `depth`."""
    return np.array([-depth / 2 - thick, y0, z0]), np.array([-depth / 2, y1, z1])


def _knobs(
    builder: Builder, x: float, z: float, across: tuple[float, float], count: int, radius: float
) -> None:
    """A row of turning knobs on the front."""
    for k in range(count):
        y = across[0] + (k + 0.5) * (across[1] - across[0]) / count
        link = builder.hinge((x, y, z), (1.0, 0.0, 0.0), float(builder.rng.uniform(2.0, 5.0)))
        length = radius * float(builder.rng.uniform(0.6, 1.6))
        builder.rod(link, (x, y, z), (x - length, y, z), radius, 10)
        if builder.rng.random() < 0.5:
            builder.box(
                link,
                (x - 1.4 * length, y - 0.2 * radius, z - radius),
                (x - length, y + 0.2 * radius, z + radius),
            )


def refrigerator(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """One to four doors, next to or above each other, sometimes with drawers below."""
    builder = Builder(rng)
    width, depth, height, thick = _sizes(rng, (0.5, 1.0), (0.5, 0.75), (0.8, 2.0), (0.04, 0.09))
    builder.shell(
        builder.body, (-depth / 2, -width / 2, 0.03), (depth / 2, width / 2, height), 0.04
    )
    handled = rng.random() < 0.75
    levels = (
        [0.03, height]
        if rng.random() < 0.4
        else [0.03, height * float(rng.uniform(0.25, 0.75)), height]
    )
    side = str(rng.choice(["left", "right"]))
    pair = rng.random() < 0.3 and width > 0.65
    for k, (z0, z1) in enumerate(itertools.pairwise(levels)):
        if k:
            builder.box(
                builder.body, (-depth / 2, -width / 2, z0 - 0.02), (depth / 2, width / 2, z0 + 0.02)
            )
        gap, upper = 0.005, float(rng.uniform(1.5, 2.4))
        if len(levels) == 3 and k == 0 and rng.random() < 0.35:
            low, high = _front(depth, thick, -width / 2, width / 2, z0 + gap, z1 - gap)
            drawer(builder, low, high, depth * 0.8, handled)
        elif pair:
            split = width * float(rng.uniform(-0.12, 0.12))
            hinged_front(
                builder,
                *_front(depth, thick, -width / 2, split - gap, z0 + gap, z1 - gap),
                "right",
                upper,
                handled,
            )
            hinged_front(
                builder,
                *_front(depth, thick, split + gap, width / 2, z0 + gap, z1 - gap),
                "left",
                upper,
                handled,
            )
        else:
            hinged_front(
                builder,
                *_front(depth, thick, -width / 2, width / 2, z0 + gap, z1 - gap),
                side,
                upper,
                handled,
            )
    return builder.finish(name, "Refrigerator")


def oven(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A door hinged below, knobs above it, sometimes a second door or a drawer, burners on top."""
    builder = Builder(rng)
    width, depth, height, thick = _sizes(rng, (0.5, 0.95), (0.5, 0.7), (0.5, 1.0), (0.025, 0.06))
    builder.shell(builder.body, (-depth / 2, -width / 2, 0.0), (depth / 2, width / 2, height), 0.03)
    panel = height * float(rng.uniform(0.1, 0.2))
    builder.box(builder.body, *_front(depth, thick, -width / 2, width / 2, height - panel, height))
    drawer_height = height * float(rng.uniform(0.12, 0.25)) if rng.random() < 0.35 else 0.0
    if drawer_height:
        low, high = _front(depth, thick, -width / 2, width / 2, 0.0, drawer_height - 0.005)
        drawer(builder, low, high, depth * 0.8, rng.random() < 0.7)
    split = rng.random() < 0.15
    handled = rng.random() < 0.9
    edges = [drawer_height, height - panel - 0.005]
    if split:
        edges.insert(1, sum(edges) / 2)
    for z0, z1 in itertools.pairwise(edges):
        side = "bottom" if rng.random() < 0.9 else str(rng.choice(["left", "right"]))
        low, high = _front(depth, thick, -width / 2, width / 2, z0 + 0.004, z1 - 0.004)
        hinged_front(builder, low, high, side, float(rng.uniform(1.2, 1.6)), handled)
    if rng.random() < 0.75:
        _knobs(
            builder,
            -depth / 2 - thick,
            height - panel / 2,
            (-width / 2, width / 2),
            int(rng.integers(1, 7)),
            panel * 0.22,
        )
    if rng.random() < 0.5:
        for sx in (-0.25, 0.25):
            for sy in (-0.25, 0.25):
                builder.rod(
                    builder.body,
                    (sx * depth, sy * width, height),
                    (sx * depth, sy * width, height + 0.015),
                    0.16 * width,
                    12,
                )
    if rng.random() < 0.3:
        builder.box(
            builder.body,
            (depth / 2 - 0.04, -width / 2, height),
            (depth / 2, width / 2, height + float(rng.uniform(0.05, 0.2))),
        )
    return builder.finish(name, "Oven")


def dishwasher(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A door hinged below, with a handle or a control panel at its top, and racks behind it."""
    builder = Builder(rng)
    width, depth, height, thick = _sizes(rng, (0.45, 0.7), (0.5, 0.65), (0.6, 0.95), (0.03, 0.07))
    builder.shell(
        builder.body, (-depth / 2, -width / 2, 0.0), (depth / 2, width / 2, height), 0.025
    )
    plinth = height * float(rng.uniform(0.0, 0.15))
    top = height * (float(rng.uniform(0.85, 0.93)) if rng.random() < 0.4 else 1.0)
    if top < height:
        builder.box(builder.body, *_front(depth, thick, -width / 2, width / 2, top + 0.004, height))
    low, high = _front(depth, thick, -width / 2, width / 2, plinth, top)
    hinged_front(builder, low, high, "bottom", float(rng.uniform(1.3, 1.6)), rng.random() < 0.75)
    if rng.random() < 0.5:
        for share in (0.25, 0.6):
            link = builder.slide((-1, 0, 0), depth * 0.7)
            z = height * share
            builder.shell(
                link,
                (-depth / 2 + 0.03, -width / 2 + 0.04, z),
                (depth / 2 - 0.06, width / 2 - 0.04, z + 0.12 * height),
                0.01,
                "top",
            )
    return builder.finish(name, "Dishwasher")


def microwave(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A wide box with a door at one side of a control panel, or one hinged below."""
    builder = Builder(rng)
    width, depth, height, thick = _sizes(rng, (0.4, 0.7), (0.28, 0.5), (0.22, 0.42), (0.02, 0.045))
    builder.shell(
        builder.body, (-depth / 2, -width / 2, 0.0), (depth / 2, width / 2, height), 0.015
    )
    panel = width * float(rng.uniform(0.15, 0.32))
    builder.box(builder.body, *_front(depth, thick, -width / 2, -width / 2 + panel, 0.0, height))
    low, high = _front(depth, thick, -width / 2 + panel + 0.003, width / 2, 0.0, height)
    side = "left" if rng.random() < 0.85 else "bottom"
    hinged_front(builder, low, high, side, float(rng.uniform(1.3, 2.2)), rng.random() < 0.65)
    if rng.random() < 0.5:
        for k in range(int(rng.integers(1, 3))):
            _knobs(
                builder,
                -depth / 2 - thick,
                height * (0.25 + 0.4 * k),
                (-width / 2, -width / 2 + panel),
                1,
                panel * 0.22,
            )
    elif rng.random() < 0.5:
        link = builder.slide((1, 0, 0), thick * 0.4)
        x, y = -depth / 2 - thick, -width / 2 + panel / 2
        builder.box(
            link, (x - 0.005, y - panel * 0.35, height * 0.08), (x, y + panel * 0.35, height * 0.2)
        )
    return builder.finish(name, "Microwave")


def safe(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A thick-walled box with a door, and a wheel or a knob on it."""
    builder = Builder(rng)
    width, depth, height = _sizes(rng, (0.3, 0.9), (0.3, 0.8), (0.3, 1.1))
    wall, thick = _sizes(rng, (0.03, 0.09), (0.03, 0.1))
    builder.shell(builder.body, (-depth / 2, -width / 2, 0), (depth / 2, width / 2, height), wall)
    side = "left" if rng.random() < 0.4 else "right"
    inset = wall if rng.random() < 0.6 else 0.0
    low, high = _front(depth, thick, -width / 2 + inset, width / 2 - inset, inset, height - inset)
    if inset:
        low[0], high[0] = -depth / 2, -depth / 2 + thick
    door = hinged_front(builder, low, high, side, float(rng.uniform(1.4, 2.4)), rng.random() < 0.4)
    if rng.random() < 0.8:
        sign = -1.0 if side == "left" else 1.0
        y = (low[1] + high[1]) / 2 + sign * float(rng.uniform(0.0, 0.25)) * (high[1] - low[1])
        z = height * float(rng.uniform(0.4, 0.65))
        wheel = builder.hinge((low[0], y, z), (1, 0, 0), 6.0, door)
        radius, out = 0.12 * width, low[0] - 0.06 * width
        builder.rod(wheel, (low[0], y, z), (out, y, z), 0.3 * radius, 8)
        for k in range(int(rng.integers(1, 4))):
            angle = k * np.pi / 3
            arm = radius * np.array([0.0, np.cos(angle), np.sin(angle)])
            middle = np.array([out, y, z])
            builder.rod(wheel, middle - arm, middle + arm, 0.1 * radius, 6)
    return builder.finish(name, "Safe")


def washing_machine(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A front loader with a round or square door, or a top loader; knobs on the panel."""
    builder = Builder(rng)
    width, depth, height = _sizes(rng, (0.5, 0.75), (0.5, 0.7), (0.75, 1.05))
    front = -depth / 2
    if rng.random() < 0.3:
        builder.shell(
            builder.body, (front, -width / 2, 0), (-front, width / 2, height), 0.03, "top"
        )
        builder.box(
            builder.body, (-front - 0.12, -width / 2, height), (-front, width / 2, height + 0.12)
        )
        lid = builder.hinge((-front - 0.12, 0, height), (0, 1, 0), float(rng.uniform(1.2, 1.7)))
        builder.box(lid, (front, -width / 2, height), (-front - 0.12, width / 2, height + 0.025))
        if rng.random() < 0.6:
            _knobs(
                builder,
                -front - 0.12,
                height + 0.06,
                (-width / 2, width / 2),
                int(rng.integers(1, 4)),
                0.03,
            )
        return builder.finish(name, "WashingMachine")
    builder.box(builder.body, (front, -width / 2, 0), (-front, width / 2, height))
    radius, z = width * float(rng.uniform(0.25, 0.4)), height * float(rng.uniform(0.42, 0.52))
    thick = float(rng.uniform(0.02, 0.06))
    left = rng.random() < 0.6
    y = radius if left else -radius
    door = builder.hinge(
        (front - thick / 2, y, z), (0, 0, -1.0 if left else 1.0), float(rng.uniform(1.4, 2.6))
    )
    if rng.random() < 0.8:
        bulge = float(rng.uniform(0.0, 0.06))
        profile = [
            (radius, 0.0),
            (radius, thick),
            (0.7 * radius, thick),
            (0.5 * radius, thick + bulge),
            (0.0, thick + bulge),
        ]
        builder.turned(door, (front, 0, z), (-1, 0, 0), profile, 24)
    else:
        builder.box(door, (front - thick, -radius, z - radius), (front, radius, z + radius))
    if rng.random() < 0.5:
        builder.handle(door, (front - thick, -0.85 * y, z), 0.3 * radius, True)
    if rng.random() < 0.7:
        _knobs(
            builder, front, height * 0.92, (-width / 4, width / 2), int(rng.integers(1, 4)), 0.03
        )
    if rng.random() < 0.4:
        low, high = (
            np.array([front - 0.01, -width / 2 + 0.02, height * 0.87]),
            np.array([front, -width / 4, height * 0.97]),
        )
        drawer(builder, low, high, depth * 0.3, False)
    return builder.finish(name, "WashingMachine")
