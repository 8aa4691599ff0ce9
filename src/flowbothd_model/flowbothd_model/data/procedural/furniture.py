"""Cabinets and tables: grids of doors, drawers and shelves."""

from __future__ import annotations

import numpy as np

from flowbothd_model.data.articulated import ArticulatedObject
from flowbothd_model.data.procedural.builder import Builder
from flowbothd_model.data.procedural.panels import DoorMode, leaf


def hinged_front(
    builder: Builder,
    low: np.ndarray,
    high: np.ndarray,
    side: str,
    upper: float,
    handle: bool = True,
    parent: int = 0,
) -> int:
    """A door on a front face that opens towards -x, hinged at left, right, bottom or top.

    Args:
        builder: Of the object.
        low: (3,) lower corner of the door.
        high: (3,) upper corner of the door.
        side: Where the hinge is.
        upper: Range [rad].
        handle: Whether there is one, at the free edge.
        parent: What the door hangs on.
    """
    rng = builder.rng
    size = high - low
    middle = (low + high) / 2
    inset = float(rng.uniform(0.05, 0.14))
    if side in ("left", "right"):
        mode = DoorMode.PULL_LEFT if side == "left" else DoorMode.PULL_RIGHT
        link = leaf(builder, low, high, mode, upper, parent)
        y = low[1] + inset * size[1] if side == "left" else high[1] - inset * size[1]
        grip, upright = (low[0], y, middle[2] + float(rng.uniform(-0.3, 0.3)) * size[2]), True
        length = float(rng.uniform(0.1, 0.6)) * size[2]
    else:
        z = low[2] if side == "bottom" else high[2]
        sign = -1.0 if side == "bottom" else 1.0
        link = builder.hinge((low[0], 0.0, z), (0.0, sign, 0.0), upper, parent)
        free = high[2] - inset * size[2] if side == "bottom" else low[2] + inset * size[2]
        grip, upright = (low[0], middle[1], free), False
        length = float(rng.uniform(0.2, 0.85)) * size[1]
    builder.box(link, low, high)
    if rng.random() < 0.25:
        margin, raised = 0.12 * size[1:].min(), 0.2 * size[0]
        builder.box(
            link,
            (low[0] - raised, low[1] + margin, low[2] + margin),
            (low[0], high[1] - margin, high[2] - margin),
        )
    if handle:
        grip_length = min(length, 0.9 * (size[2] if upright else size[1]))
        builder.handle(link, grip, max(grip_length, 0.04), upright)
    return link


def drawer(
    builder: Builder, low: np.ndarray, high: np.ndarray, depth: float, handle: bool = True
) -> int:
    """A drawer whose front lies between `low` and `high`, sliding towards -x by most of `depth`."""
    rng = builder.rng
    link = builder.slide((-1.0, 0.0, 0.0), depth * float(rng.uniform(0.5, 0.9)))
    builder.box(link, low, high)
    wall = 0.02 * float(high[1] - low[1])
    top = low[2] + (high[2] - low[2]) * float(rng.uniform(0.5, 0.9))
    builder.shell(
        link,
        (high[0], low[1] + 2 * wall, low[2] + wall),
        (high[0] + 0.9 * depth, high[1] - 2 * wall, top),
        wall,
        "top",
    )
    if handle:
        size = high - low
        twice = size[1] > 3.5 * size[2] and rng.random() < 0.3
        for share in (0.25, 0.75) if twice else (0.5,):
            grip = (
                low[0],
                low[1] + share * size[1],
                (low[2] + high[2]) / 2 + float(rng.uniform(-0.2, 0.3)) * size[2],
            )
            builder.handle(
                link, grip, float(rng.uniform(0.15, 0.5)) * min(size[1], 3 * size[2]), False
            )
    return link


def storage(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """Storage furniture: columns of doors, drawers and open shelves, on legs, plinth or wall."""
    builder = Builder(rng)
    width, depth, height = (float(rng.uniform(*r)) for r in ((0.4, 2.0), (0.3, 0.65), (0.4, 2.2)))
    wall = float(rng.uniform(0.012, 0.03))
    lift = float(rng.uniform(0.05, 0.25)) if rng.random() < 0.4 else 0.0
    if lift:
        _legs(builder, depth, width, lift)
    bottom, top = lift, lift + height
    builder.shell(builder.body, (-depth / 2, -width / 2, bottom), (depth / 2, width / 2, top), wall)
    columns = int(np.clip(round(width / float(rng.uniform(0.35, 0.8))), 1, 4))
    handled = rng.random() < 0.8
    filled = _fill(builder, columns, (-width / 2, width / 2), (bottom, top), depth, wall, handled)
    if not filled:
        low = np.array([-depth / 2 - wall, -width / 2, bottom])
        hinged_front(builder, low, np.array([-depth / 2, width / 2, top]), "left", 1.6, handled)
    return builder.finish(name, "StorageFurniture")


def _legs(builder: Builder, depth: float, width: float, height: float) -> None:
    """Four legs, round or square, a little inside the corners."""
    rng = builder.rng
    thick, inset = float(rng.uniform(0.015, 0.04)), float(rng.uniform(0.0, 0.08))
    round_legs = rng.random() < 0.5
    for sx in (-1.0, 1.0):
        for sy in (-1.0, 1.0):
            x, y = sx * (depth / 2 - thick - inset), sy * (width / 2 - thick - inset)
            if round_legs:
                builder.rod(builder.body, (x, y, 0), (x, y, height), thick, 8)
            else:
                builder.box(builder.body, (x - thick, y - thick, 0), (x + thick, y + thick, height))


def _fill(
    builder: Builder,
    columns: int,
    across: tuple[float, float],
    up: tuple[float, float],
    depth: float,
    wall: float,
    handled: bool,
) -> int:
    """Fill the front with doors, drawers and open cells; returns the number of moving parts."""
    rng = builder.rng
    front, gap = -depth / 2, 0.004
    overlay = rng.random() < 0.6  # fronts in front of the carcass, or between its boards
    x0, x1 = (front - wall, front) if overlay else (front, front + wall)
    edge = 0.0 if overlay else wall
    step = (across[1] - across[0]) / columns
    shared = _cells(rng) if rng.random() < 0.5 else None
    moving = 0
    for column in range(columns):
        y0, y1 = across[0] + column * step, across[0] + (column + 1) * step
        if column:
            builder.box(builder.body, (front, y0 - wall / 2, up[0]), (-front, y0 + wall / 2, up[1]))
        cells = shared or _cells(rng)
        heights = np.array([share for _, share in cells])
        levels = up[0] + np.concatenate(([0.0], np.cumsum(heights / heights.sum()))) * (
            up[1] - up[0]
        )
        for (kind, _), z0, z1 in zip(cells, levels[:-1], levels[1:], strict=True):
            low = np.array([x0, y0 + edge + gap, z0 + edge + gap])
            high = np.array([x1, y1 - edge - gap, z1 - edge - gap])
            if z1 < up[1] - 1e-6:
                builder.box(builder.body, (front, y0, z1 - wall / 2), (-front, y1, z1 + wall / 2))
            if kind == "drawer":
                drawer(builder, low, high, depth * 0.85, handled)
            elif kind == "door":
                _cell_doors(builder, low, high, handled, column, columns)
            moving += kind != "open"
    return moving


def _cells(rng: np.random.Generator) -> list[tuple[str, float]]:
    """Kinds and relative heights of the cells of one column, from below."""
    style = float(rng.random())
    if style < 0.3:
        return [("drawer", float(rng.uniform(0.7, 1.3))) for _ in range(int(rng.integers(1, 6)))]
    if style < 0.55:
        return [("door", 1.0)]
    count = int(rng.integers(2, 4))
    kinds = rng.choice(["door", "drawer", "open"], size=count, p=[0.45, 0.35, 0.2])
    scale = {"door": 2.0, "drawer": 0.7, "open": 1.2}
    return [(str(k), scale[str(k)] * float(rng.uniform(0.6, 1.4))) for k in kinds]


def _cell_doors(
    builder: Builder, low: np.ndarray, high: np.ndarray, handled: bool, column: int, columns: int
) -> None:
    """One door or a pair over a cell."""
    rng = builder.rng
    upper = float(rng.uniform(1.4, 2.4))
    if (high - low)[1] > 0.5 and rng.random() < 0.6:
        middle = (low[1] + high[1]) / 2
        right = np.array([high[0], middle - 0.002, high[2]])
        hinged_front(builder, low, right, "right", upper, handled)
        hinged_front(
            builder, np.array([low[0], middle + 0.002, low[2]]), high, "left", upper, handled
        )
        return
    wide = (high - low)[1] > 1.5 * (high - low)[2]
    if wide and rng.random() < 0.5:
        side = "top" if rng.random() < 0.6 else "bottom"
    elif columns > 1 and rng.random() < 0.7:
        side = "right" if column % 2 == 0 else "left"
    else:
        side = "left" if rng.random() < 0.5 else "right"
    hinged_front(builder, low, high, side, upper, handled)


def table(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A table or desk: drawers under the top, or a chest of doors and drawers at its side."""
    builder = Builder(rng)
    width, depth, height = (float(rng.uniform(*r)) for r in ((0.5, 1.8), (0.35, 0.9), (0.4, 0.85)))
    thick, apron = float(rng.uniform(0.015, 0.05)), float(rng.uniform(0.08, 0.22))
    over = float(rng.uniform(0.0, 0.05))
    builder.box(
        builder.body,
        (-depth / 2 - over, -width / 2 - over, height - thick),
        (depth / 2 + over, width / 2 + over, height),
    )
    handled = rng.random() < 0.8
    _legs(builder, depth, width, height - thick)
    top = height - thick
    wall = 0.015
    if rng.random() < 0.55:
        builder.shell(
            builder.body, (-depth / 2, -width / 2, top - apron), (depth / 2, width / 2, top), wall
        )
        count = int(rng.integers(1, 4))
        for k in range(count):
            y0, y1 = -width / 2 + k * width / count, -width / 2 + (k + 1) * width / count
            low = np.array([-depth / 2 - wall, y0 + 0.004, top - apron + 0.004])
            drawer(
                builder, low, np.array([-depth / 2, y1 - 0.004, top - 0.004]), depth * 0.8, handled
            )
    if not builder.moving or rng.random() < 0.4:
        bottom = 0.0 if rng.random() < 0.6 else height * 0.35
        ceiling = top - (apron if builder.moving else 0.0)
        sides = (-1.0, 1.0) if rng.random() < 0.35 else (float(rng.choice([-1.0, 1.0])),)
        share = width * float(rng.uniform(0.22, 0.4))
        for side in sides:
            across = (
                (-width / 2, -width / 2 + share) if side < 0 else (width / 2 - share, width / 2)
            )
            builder.shell(
                builder.body, (-depth / 2, across[0], bottom), (depth / 2, across[1], ceiling), wall
            )
            _fill(builder, 1, across, (bottom, ceiling), depth, wall, handled)
    if not builder.moving:
        low = np.array([-depth / 2 - wall, -width / 2, top - apron])
        drawer(builder, low, np.array([-depth / 2, width / 2, top]), depth * 0.8, True)
    return builder.finish(name, "Table")
