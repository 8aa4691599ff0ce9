"""Doors and windows: all four modes of a door, with and without handles, and sliding ones."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from flowbothd_model.data.articulated import ArticulatedObject
from flowbothd_model.data.procedural.builder import Builder


class DoorMode(StrEnum):
    """Side of the hinge as seen from the front (-x), and whether the leaf comes to the viewer."""

    PULL_LEFT = "pull_left"
    PULL_RIGHT = "pull_right"
    PUSH_LEFT = "push_left"
    PUSH_RIGHT = "push_right"


def leaf(
    builder: Builder,
    low: np.ndarray,
    high: np.ndarray,
    mode: DoorMode,
    upper: float,
    parent: int = 0,
) -> int:
    """A hinged link for a leaf between the corners `low` and `high`; the caller adds its shape.

    Seen from -x, the left is +y.
    """
    left = mode in (DoorMode.PULL_LEFT, DoorMode.PUSH_LEFT)
    pull = mode in (DoorMode.PULL_LEFT, DoorMode.PULL_RIGHT)
    y = high[1] if left else low[1]
    x = low[0] if pull else high[0]
    # Opening towards -x about a hinge at +y is a negative turn about z.
    up = -1.0 if left == pull else 1.0
    return builder.hinge((x, y, 0.0), (0.0, 0.0, up), upper, parent)


def four_mode_door(
    rng: np.random.Generator, mode: DoorMode, name: str = "door", jitter: float = 0.0
) -> ArticulatedObject:
    """The paper's custom door: nothing visible shows which of the four ways it opens.

    Leaf 16.83 x 1.75 x 43.5 cm in a frame of 25 x 8.5 x 43.8 cm on a base of 31.75 x 36 x 1.25 cm;
    `jitter` varies every measure by up to that share, and then the door is scaled like all objects;
    without it the door has its real size.
    """

    def size(value: float) -> float:
        return value * float(rng.uniform(1 - jitter, 1 + jitter)) if jitter else value

    builder = Builder(rng)
    width, thick, height = size(0.1683), size(0.0175), size(0.435)
    frame_width, frame_depth = max(size(0.25), width * 1.15), size(0.085)
    base_width, base_depth, base_height = size(0.3175), size(0.36), size(0.0125)
    top = base_height + height + 0.003
    post = (frame_width - width) / 2 - 0.001
    builder.box(
        builder.body,
        (-base_depth / 2, -base_width / 2, 0),
        (base_depth / 2, base_width / 2, base_height),
    )
    for side in (-1.0, 1.0):
        inner = side * (frame_width / 2 - post)
        outer = side * frame_width / 2
        builder.box(
            builder.body,
            (-frame_depth / 2, min(inner, outer), base_height),
            (frame_depth / 2, max(inner, outer), top),
        )
    if jitter and rng.random() < 0.4:
        lintel = float(rng.uniform(0.01, 0.06))
        builder.box(
            builder.body,
            (-frame_depth / 2, -frame_width / 2, top),
            (frame_depth / 2, frame_width / 2, top + lintel),
        )
    shift = (
        0.0
        if not jitter
        else float(rng.uniform(-0.5, 0.5)) * (frame_depth - thick) * (rng.random() < 0.3)
    )
    low = np.array([shift - thick / 2, -width / 2, base_height + 0.001])
    high = np.array([shift + thick / 2, width / 2, base_height + height])
    link = leaf(builder, low, high, mode, np.radians(70 if not jitter else rng.uniform(60, 110)))
    builder.box(link, low, high)
    return builder.finish(name, "Door", 2.0 if jitter else None)


def door(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A door: the ambiguous family, or a full-sized one with frame, panels and handles."""
    modes = list(DoorMode)
    if rng.random() < 0.45:
        return four_mode_door(rng, modes[int(rng.integers(4))], name, jitter=0.25)
    builder = Builder(rng)
    height, width = float(rng.uniform(1.7, 2.4)), float(rng.uniform(0.6, 1.1))
    thick, depth = float(rng.uniform(0.03, 0.07)), float(rng.uniform(0.05, 0.25))
    post = float(rng.uniform(0.03, 0.15))
    leaves = 2 if rng.random() < 0.3 else 1
    total = width * leaves
    extra = float(rng.uniform(0, 0.6)) if rng.random() < 0.4 else 0.0
    for side in (-1.0, 1.0):
        inner, outer = side * total / 2, side * (total / 2 + post + extra)
        builder.box(
            builder.body, (-depth / 2, min(inner, outer), 0), (depth / 2, max(inner, outer), height)
        )
    roof = post + (float(rng.uniform(0, 0.4)) if extra else 0.0)
    half = total / 2 + post + extra
    builder.box(builder.body, (-depth / 2, -half, height), (depth / 2, half, height + roof))
    if rng.random() < 0.2:
        builder.box(builder.body, (-depth / 2, -half, -0.02), (depth / 2, half, 0.0))
    pull = rng.random() < 0.5
    # Most frames tell: the leaf lies flush with the side to which it opens.
    flush = (-1.0 if pull else 1.0) * (depth - thick) / 2 if rng.random() < 0.5 else 0.0
    sliding = leaves == 1 and rng.random() < 0.1
    handled = rng.random() < 0.65
    for k in range(leaves):
        low = np.array([flush - thick / 2, -total / 2 + k * width, 0.01])
        high = np.array([flush + thick / 2, -total / 2 + (k + 1) * width, height - 0.01])
        left = k == 1 if leaves == 2 else rng.random() < 0.5
        mode = (
            (DoorMode.PULL_LEFT if left else DoorMode.PULL_RIGHT)
            if pull
            else (DoorMode.PUSH_LEFT if left else DoorMode.PUSH_RIGHT)
        )
        if sliding:
            low[0] -= depth / 2
            high[0] -= depth / 2
            link = builder.slide((0, 1.0 if left else -1.0, 0), width * 0.9)
        else:
            link = leaf(builder, low, high, mode, float(np.radians(rng.uniform(70, 110))))
        _panel(builder, link, low, high)
        if handled:
            _handles(builder, link, low, high, left)
    return builder.finish(name, "Door")


def _panel(builder: Builder, link: int, low: np.ndarray, high: np.ndarray) -> None:
    """The leaf: plain, with raised panels, or with a pane set back in stiles and rails."""
    rng = builder.rng
    style = int(rng.integers(3))
    if style == 2:
        stile = float(rng.uniform(0.06, 0.16)) * (high[1] - low[1])
        inset = 0.35 * (high[0] - low[0])
        for y0, y1, z0, z1 in (
            (low[1], low[1] + stile, low[2], high[2]),
            (high[1] - stile, high[1], low[2], high[2]),
            (low[1], high[1], low[2], low[2] + stile),
            (low[1], high[1], high[2] - stile, high[2]),
        ):
            builder.box(link, (low[0], y0, z0), (high[0], y1, z1))
        if rng.random() < 0.8:
            builder.box(link, (low[0] + inset, low[1], low[2]), (high[0] - inset, high[1], high[2]))
        return
    builder.box(link, low, high)
    if style == 1:
        rows = int(rng.integers(1, 4))
        raised = 0.2 * (high[0] - low[0])
        step = (high[2] - low[2]) / rows
        margin = 0.15 * (high[1] - low[1])
        for k in range(rows):
            builder.box(
                link,
                (low[0] - raised, low[1] + margin, low[2] + k * step + 0.1 * step),
                (high[0] + raised, high[1] - margin, low[2] + (k + 1) * step - 0.1 * step),
            )


def _handles(builder: Builder, link: int, low: np.ndarray, high: np.ndarray, left: bool) -> None:
    """Handles at the free edge, on both faces or only on one."""
    rng = builder.rng
    span = high[1] - low[1]
    inset = float(rng.uniform(0.06, 0.14)) * span
    y = low[1] + inset if left else high[1] - inset
    z = low[2] + float(rng.uniform(0.4, 0.55)) * (high[2] - low[2])
    length = float(rng.uniform(0.08, 0.3)) * (high[2] - low[2])
    state = builder.rng.bit_generator.state
    builder.handle(link, (low[0], y, z), length, True, -1.0)
    if rng.random() < 0.8:
        after = builder.rng.bit_generator.state
        builder.rng.bit_generator.state = state  # the same handle on the other face
        builder.handle(link, (high[0], y, z), length, True, 1.0)
        builder.rng.bit_generator.state = after


def window(rng: np.random.Generator, name: str) -> ArticulatedObject:
    """A window: sashes that swing to the side, tilt, or slide sideways or up."""
    builder = Builder(rng)
    height, width = float(rng.uniform(0.8, 1.8)), float(rng.uniform(0.7, 2.0))
    depth, post = float(rng.uniform(0.06, 0.15)), float(rng.uniform(0.03, 0.09))
    for y0, y1, z0, z1 in (
        (-width / 2 - post, -width / 2, -post, height + post),
        (width / 2, width / 2 + post, -post, height + post),
        (-width / 2, width / 2, -post, 0.0),
        (-width / 2, width / 2, height, height + post),
    ):
        builder.box(builder.body, (-depth / 2, y0, z0), (depth / 2, y1, z1))
    thick = float(rng.uniform(0.02, 0.04))
    kind = str(rng.choice(["swing", "tilt", "slide", "lift"], p=[0.35, 0.15, 0.3, 0.2]))
    vertical = kind == "lift" or (kind == "tilt" and rng.random() < 0.3)
    count = 2 if kind in ("slide", "lift") else int(rng.integers(1, 4))
    for k in range(count):
        low = np.array([-thick / 2, -width / 2 + k * width / count, 0.0])
        high = np.array([thick / 2, -width / 2 + (k + 1) * width / count, height])
        if vertical:
            low[1:], high[1:] = (
                (-width / 2, k * height / count),
                (width / 2, (k + 1) * height / count),
            )
        if kind in ("slide", "lift"):
            shift = thick * (0.6 if k else -0.6)
            low[0] += shift
            high[0] += shift
        link = _sash(builder, kind, low, high, k, count, vertical)
        _panel(builder, link, low, high)
        if rng.random() < 0.4:
            builder.handle(
                link,
                (
                    low[0],
                    (low[1] + high[1]) / 2 if kind == "tilt" else high[1] - 0.05 * width,
                    (low[2] + high[2]) / 2,
                ),
                0.1 * height,
                True,
            )
    return builder.finish(name, "Window")


def _sash(
    builder: Builder,
    kind: str,
    low: np.ndarray,
    high: np.ndarray,
    k: int,
    count: int,
    vertical: bool,
) -> int:
    """The link of the k-th sash of a window."""
    rng = builder.rng
    if kind == "slide":
        return builder.slide((0, 1.0 if k == 0 else -1.0, 0), (high[1] - low[1]) * 0.9)
    if kind == "lift":
        return builder.slide((0, 0, 1.0 if k == 0 else -1.0), (high[2] - low[2]) * 0.9)
    outward = 1.0 if rng.random() < 0.5 else -1.0
    if kind == "tilt":
        top = rng.random() < 0.6
        z = high[2] if top else low[2]
        return builder.hinge(
            (0, 0, z), (0, outward if top else -outward, 0), float(rng.uniform(0.6, 1.4))
        )
    left = rng.random() < 0.5 if count == 1 or vertical else k >= count / 2
    modes = (
        (DoorMode.PULL_LEFT if left else DoorMode.PULL_RIGHT)
        if outward < 0
        else (DoorMode.PUSH_LEFT if left else DoorMode.PUSH_RIGHT)
    )
    return leaf(builder, low, high, modes, float(rng.uniform(0.9, 1.6)))
