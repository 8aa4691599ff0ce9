"""A small kit for articulated objects: links, joints, boxes, cylinders, surfaces of revolution."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.types import Array
from flowbothd_model.data.articulated import (
    ArticulatedObject,
    Ints,
    JointKind,
    LinkJoint,
    axis_rotation,
)

Vector = Sequence[float] | NDArray[Any]
_BOX_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
     [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]]
)  # fmt: skip


class Builder:
    """Collects the links of one object; all coordinates are of the closed object [m].

    Args:
        rng: Source of all chance in the object, for the maker to draw from.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self._joints: list[LinkJoint] = []
        self._vertices: list[Array] = []
        self._faces: list[Ints] = []
        self._owner: list[Ints] = []
        self._count = 0
        self.body = self.fixed()

    def fixed(self, parent: int = -1) -> int:
        """A link that does not move against `parent`; returns its index."""
        self._joints.append(LinkJoint(parent))
        return len(self._joints) - 1

    def hinge(self, point: Vector, axis: Vector, upper: float, parent: int = 0) -> int:
        """A link that turns by up to `upper` [rad] about `axis` through `point`."""
        return self._moving(JointKind.REVOLUTE, point, axis, upper, parent)

    def slide(self, axis: Vector, upper: float, parent: int = 0) -> int:
        """A link that slides by up to `upper` [m] along `axis`."""
        return self._moving(JointKind.PRISMATIC, (0.0, 0.0, 0.0), axis, upper, parent)

    def _moving(
        self, kind: JointKind, point: Vector, axis: Vector, upper: float, parent: int
    ) -> int:
        direction = np.asarray(axis, dtype=float)
        direction /= np.linalg.norm(direction)
        index = len(self._joints)
        self._joints.append(
            LinkJoint(
                parent,
                kind,
                (float(direction[0]), float(direction[1]), float(direction[2])),
                (float(point[0]), float(point[1]), float(point[2])),
                0.0,
                float(upper),
                f"joint_{index}",
            )
        )
        return index

    @property
    def moving(self) -> int:
        """Number of moving links so far."""
        return sum(joint.kind is not JointKind.FIXED for joint in self._joints)

    def mesh(self, link: int, vertices: Array, faces: Ints) -> None:
        """Add a triangle mesh (V, 3), (F, 3) to `link`."""
        self._vertices.append(vertices)
        self._faces.append(faces + self._count)
        self._owner.append(np.full(len(vertices), link, dtype=np.int64))
        self._count += len(vertices)

    def box(self, link: int, low: Vector, high: Vector) -> None:
        """An axis-parallel box between two corners."""
        ends = np.array([low, high], dtype=float)
        corners = np.array(
            [[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        )
        self.mesh(link, corners, _BOX_FACES)

    def shell(
        self, link: int, low: Vector, high: Vector, wall: float, open_side: str = "front"
    ) -> None:
        """A hollow box of five boards; `open_side` is front (-x), top or bottom."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        if open_side != "front":
            self.box(link, (x0, y0, z0), (x0 + wall, y1, z1))
        self.box(link, (x1 - wall, y0, z0), (x1, y1, z1))
        self.box(link, (x0, y0, z0), (x1, y0 + wall, z1))
        self.box(link, (x0, y1 - wall, z0), (x1, y1, z1))
        if open_side != "bottom":
            self.box(link, (x0, y0, z0), (x1, y1, z0 + wall))
        if open_side != "top":
            self.box(link, (x0, y0, z1 - wall), (x1, y1, z1))

    def rod(self, link: int, start: Vector, end: Vector, radius: float, sides: int = 10) -> None:
        """A solid cylinder between two points."""
        a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
        length = float(np.linalg.norm(b - a))
        self.turned(
            link, a, b - a, [(0.0, 0.0), (radius, 0.0), (radius, length), (0.0, length)], sides
        )

    def turned(
        self,
        link: int,
        origin: Vector,
        axis: Vector,
        profile: Sequence[tuple[float, float]],
        sides: int = 20,
    ) -> None:
        """A surface of revolution: `profile` is (radius, height along `axis` from `origin`)."""
        z = np.asarray(axis, dtype=float)
        z /= np.linalg.norm(z)
        x = np.cross(z, [1.0, 0.0, 0.0] if abs(z[0]) < 0.9 else [0.0, 1.0, 0.0])
        x /= np.linalg.norm(x)
        angle = np.arange(sides) * 2 * np.pi / sides
        ring = np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * np.cross(z, x)
        rings = [np.asarray(origin, dtype=float) + r * ring + h * z for r, h in profile]
        index = np.arange(sides)
        after = (index + 1) % sides
        faces = []
        for k in range(len(profile) - 1):
            low, high = k * sides, (k + 1) * sides
            faces.append(np.stack((low + index, low + after, high + index), 1))
            faces.append(np.stack((low + after, high + after, high + index), 1))
        self.mesh(link, np.concatenate(rings), np.concatenate(faces))

    def arc(
        self,
        link: int,
        center: Vector,
        start: Vector,
        axis: Vector,
        angle: float,
        radius: float,
        pieces: int = 8,
    ) -> None:
        """A bent rod: `start` - `center` swept by `angle` [rad] about `axis`."""
        unit_axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        arm = np.asarray(start, dtype=float) - np.asarray(center, dtype=float)
        points = [
            np.asarray(center) + axis_rotation(unit_axis, angle * k / pieces) @ arm
            for k in range(pieces + 1)
        ]
        for a, b in itertools.pairwise(points):
            self.rod(link, a, b, radius, 6)

    def handle(
        self, link: int, center: Vector, length: float, upright: bool, out: float = -1.0
    ) -> None:
        """One of several handles on a face that looks along x: bar, bow, knob or block.

        Args:
            link: What it is fixed to.
            center: A point on the face.
            length: Of a bar.
            upright: A bar along z rather than y.
            out: Direction along x in which it stands out.
        """
        x, y, z = (float(value) for value in center)
        style = int(self.rng.integers(4))
        depth = out * length * float(self.rng.uniform(0.12, 0.3))
        thick = length * float(self.rng.uniform(0.03, 0.08))
        along = np.array([0.0, 0.0, 1.0]) if upright else np.array([0.0, 1.0, 0.0])
        base = np.array([x, y, z])
        away = np.array([depth, 0.0, 0.0])
        if style == 0:
            for side in (-0.4, 0.4):
                self.rod(
                    link,
                    base + side * length * along,
                    base + side * length * along + away,
                    thick,
                    6,
                )
            self.rod(
                link,
                base - 0.5 * length * along + away,
                base + 0.5 * length * along + away,
                thick,
                8,
            )
        elif style == 1:
            axis = np.cross(
                along, [out, 0.0, 0.0]
            )  # from one end of the bow, outwards, to the other
            self.arc(link, base, base + 0.5 * length * along, axis, np.pi, thick, 6)
        elif style == 2:
            radius = length * float(self.rng.uniform(0.08, 0.16))
            stem = abs(depth)
            self.turned(
                link, base, (out, 0.0, 0.0),
                [(radius * 0.5, 0.0), (radius * 0.5, stem * 0.5), (radius, stem * 0.6),
                 (radius, stem), (0.0, stem)], 10,
            )  # fmt: skip
        else:
            half = 0.5 * length * along + np.array([0.0, thick, thick])
            low, high = base - half, base + half
            low[0], high[0] = min(x, x + depth), max(x, x + depth)
            self.box(link, low, high)

    def finish(self, name: str, category: str, diagonal: float | None = 2.0) -> ArticulatedObject:
        """The object, scaled to a `diagonal` [m] (PartNet's objects have about 2), or as built."""
        vertices = np.concatenate(self._vertices)
        scale = 1.0
        if diagonal is not None:
            scale = diagonal / float(np.linalg.norm(np.ptp(vertices, axis=0)))
        joints = [
            replace(
                joint,
                point=(scale * joint.point[0], scale * joint.point[1], scale * joint.point[2]),
                upper=joint.upper * (scale if joint.kind is JointKind.PRISMATIC else 1.0),
            )
            for joint in self._joints
        ]
        return ArticulatedObject(
            name,
            category,
            (vertices * scale).astype(np.float32),
            np.concatenate(self._faces).astype(np.int64),
            np.concatenate(self._owner),
            tuple(joints),
        )
