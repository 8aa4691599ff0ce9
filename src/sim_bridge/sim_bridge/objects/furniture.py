"""Procedural furniture of tabletop size: a drawer, a cabinet with a door, a box with a lid."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from sim_bridge.objects.boxes import BoxUrdf, Vector
from sim_bridge.objects.from_urdf import model_from_urdf, standing_at
from sim_bridge.objects.model import ObjectModel

_BODY = (0.74, 0.71, 0.66)
_FRONT = (0.80, 0.52, 0.27)
Boxes = list[tuple[Vector, Vector]]


@dataclass(frozen=True)
class DrawerSizes:
    """Outer dimensions of the chest, travel of the drawer, wall thickness [m]; its mass [kg]."""

    width: float = 0.30
    depth: float = 0.30
    height: float = 0.20
    wall: float = 0.012
    travel: float = 0.22
    mass: float = 0.8


@dataclass(frozen=True)
class CabinetDoorSizes:
    """Outer dimensions and wall of the cabinet [m], door range in degrees, door mass [kg]."""

    width: float = 0.26
    depth: float = 0.20
    height: float = 0.36
    wall: float = 0.014
    range_deg: float = 90.0
    mass: float = 0.7


@dataclass(frozen=True)
class LiddedBoxSizes:
    """Outer dimensions with the lid and wall of the box [m], lid range in degrees, mass [kg]."""

    width: float = 0.28
    depth: float = 0.22
    height: float = 0.16
    wall: float = 0.010
    range_deg: float = 90.0
    mass: float = 0.35


Sizes = TypeVar("Sizes", DrawerSizes, CabinetDoorSizes, LiddedBoxSizes)


def vary(sizes: Sizes, seed: int) -> Sizes:
    """Draw width, depth and height within 15 % of the nominal ones; seed 0 keeps them."""
    if seed == 0:
        return sizes
    rng = np.random.default_rng(seed)
    varied = {
        item.name: float(getattr(sizes, item.name) * rng.uniform(0.85, 1.15))
        for item in fields(sizes)
        if item.name in ("width", "depth", "height")
    }
    return replace(sizes, **varied)


def drawer(mode: str, seed: int, sizes: DrawerSizes) -> ObjectModel:
    """Build a chest with one drawer. Front along -x, z up, origin under the middle of the chest."""
    w, d, h, t = sizes.width, sizes.depth, sizes.height, sizes.wall
    urdf = BoxUrdf("drawer")
    urdf.link("chest", _open_box(w, d, h, t), mass=4.0, color=_BODY)
    inner_w, inner_h, clear = w - 2 * t, h - 2 * t, 0.003
    front = -d / 2 + t / 2
    floor = t + clear
    side_h = 0.6 * inner_h
    travel = min(sizes.travel, d - 3 * t)
    depth = d - 2 * t - clear
    middle = front + t / 2 + depth / 2
    boxes: Boxes = [
        ((front, 0, h / 2), (t, inner_w - 2 * clear, inner_h - 2 * clear)),
        ((middle, 0, floor + t / 4), (depth, inner_w - 4 * clear, t / 2)),
        (
            (front + t / 2 + depth - t / 4, 0, floor + side_h / 2),
            (t / 2, inner_w - 4 * clear, side_h),
        ),
    ]
    y = inner_w / 2 - 2 * clear - t / 4
    boxes += [((middle, s * y, floor + side_h / 2), (depth, t / 2, side_h)) for s in (1, -1)]
    urdf.link("tray", boxes, mass=sizes.mass, color=_FRONT)
    urdf.joint("slide", "prismatic", "chest", "tray", (-1, 0, 0), (0, travel))
    return _placed(urdf, "drawer", mode, seed, (0.75, -0.15, 0.0))


def cabinet_door(mode: str, seed: int, sizes: CabinetDoorSizes) -> ObjectModel:
    """Build a cabinet whose door lies on its front. Mode: the hinge's side seen from the front."""
    w, d, h, t = sizes.width, sizes.depth, sizes.height, sizes.wall
    urdf = BoxUrdf("cabinet_door")
    urdf.link("cabinet", _open_box(w, d, h, t), mass=5.0, color=_BODY)
    side = 1 if mode == "left" else -1
    x, clear = -d / 2 - t / 2 - 0.002, 0.002
    urdf.link(
        "door",
        [((x, 0, h / 2), (t, w - 2 * clear, h - 2 * clear))],
        mass=sizes.mass,
        color=_FRONT,
        # The edge on the outside: the door turns clear of the cabinet's front.
        origin=(x - t / 2, side * w / 2, h / 2),
    )
    limits = (0, np.deg2rad(sizes.range_deg))
    urdf.joint("hinge", "revolute", "cabinet", "door", (0, 0, -side), limits)
    return _placed(urdf, "cabinet_door", mode, seed, (0.60, -0.15 * side, side * np.pi / 3))


def lidded_box(mode: str, seed: int, sizes: LiddedBoxSizes) -> ObjectModel:
    """Build a box whose lid is hinged along its back (+x) edge and opens upwards."""
    w, d, h, t = sizes.width, sizes.depth, sizes.height, sizes.wall
    urdf = BoxUrdf("lidded_box")
    body = h - t - 0.001
    walls: Boxes = [
        ((0, 0, t / 2), (d, w, t)),
        ((d / 2 - t / 2, 0, body / 2), (t, w, body)),
        ((-d / 2 + t / 2, 0, body / 2), (t, w, body)),
        ((0, w / 2 - t / 2, body / 2), (d, t, body)),
        ((0, -w / 2 + t / 2, body / 2), (d, t, body)),
    ]
    urdf.link("box", walls, mass=1.0, color=_BODY)
    urdf.link(
        "lid",
        [((0, 0, h - t / 2), (d, w, t))],
        mass=sizes.mass,
        color=_FRONT,
        origin=(d / 2, 0, h - t / 2),
    )
    limits = (0, np.deg2rad(sizes.range_deg))
    # The lid reaches from its hinge towards -x: a positive turn about +y lifts it.
    urdf.joint("hinge", "revolute", "box", "lid", (0, 1, 0), limits)
    return _placed(urdf, "lidded_box", mode, seed, (0.50, 0.0, 2 * np.pi / 3))


def _open_box(width: float, depth: float, height: float, wall: float) -> Boxes:
    """Five panels, open towards -x."""
    return [
        ((0, 0, wall / 2), (depth, width, wall)),
        ((0, 0, height - wall / 2), (depth, width, wall)),
        ((0, width / 2 - wall / 2, height / 2), (depth, wall, height - 2 * wall)),
        ((0, -width / 2 + wall / 2, height / 2), (depth, wall, height - 2 * wall)),
        ((depth / 2 - wall / 2, 0, height / 2), (wall, width - 2 * wall, height - 2 * wall)),
    ]


def _placed(
    urdf: BoxUrdf, name: str, mode: str, seed: int, place: tuple[float, float, float]
) -> ObjectModel:
    """The model, standing at x, y [m] and yaw [rad].

    The places were found by search with the simulated arm: the drawer next to the arm's own plane,
    where its elbow has room; the cabinet turned so that its door swings past the arm; the lid's
    hinge turned towards the arm, so that the tool need not reach over the lid from behind.
    """
    model = model_from_urdf(urdf.text(), name, mode=mode, seed=seed)
    return replace(model, default_pose=standing_at(model, *place))
