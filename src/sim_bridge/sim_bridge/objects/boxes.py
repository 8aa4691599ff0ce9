"""A small writer of URDFs made of boxes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

Vector = Sequence[float]


class BoxUrdf:
    """Collects links of boxes and joints between them, and gives the URDF text.

    Box positions are given in the OBJECT frame, joint origins too (all rotations are the identity),
    so that a link's boxes do not depend on where its joint sits.
    """

    def __init__(self, name: str) -> None:
        self._robot = ET.Element("robot", name=name)
        self._origins: dict[str, tuple[float, ...]] = {}

    def link(
        self,
        name: str,
        boxes: Sequence[tuple[Vector, Vector]],
        *,
        mass: float,
        color: Vector,
        origin: Vector = (0.0, 0.0, 0.0),
    ) -> None:
        """Add a link.

        Args:
            name: Link name.
            boxes: (centre, edge lengths) of each box [m], object frame.
            mass: [kg], spread over the bounding box.
            color: red, green, blue 0..1.
            origin: Origin of the link frame in the object frame [m]: a point on its joint axis.
        """
        element = ET.SubElement(self._robot, "link", name=name)
        self._origins[name] = tuple(float(v) for v in origin)
        for centre, size in boxes:
            local = [float(c) - o for c, o in zip(centre, self._origins[name], strict=True)]
            for kind in ("visual", "collision"):
                shape = ET.SubElement(element, kind)
                ET.SubElement(shape, "origin", xyz=_text(local), rpy="0 0 0")
                ET.SubElement(ET.SubElement(shape, "geometry"), "box", size=_text(size))
                if kind == "visual":
                    material = ET.SubElement(shape, "material", name=f"{name}_color")
                    ET.SubElement(material, "color", rgba=_text([*color, 1.0]))
        self._inertial(element, boxes, mass, self._origins[name])

    def joint(
        self, name: str, kind: str, parent: str, child: str, axis: Vector, limits: Vector
    ) -> None:
        """Add a revolute or prismatic joint at the child's origin; both links must exist."""
        joint = ET.SubElement(self._robot, "joint", name=name, type=kind)
        above, below = self._origins[parent], self._origins[child]
        offset = [b - a for a, b in zip(above, below, strict=True)]
        ET.SubElement(joint, "origin", xyz=_text(offset), rpy="0 0 0")
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        ET.SubElement(joint, "axis", xyz=_text(axis))
        ET.SubElement(
            joint,
            "limit",
            lower=_number(limits[0]),
            upper=_number(limits[1]),
            effort="100",
            velocity="10",
        )

    def text(self) -> str:
        """The URDF."""
        ET.indent(self._robot)
        return ET.tostring(self._robot, encoding="unicode")

    @staticmethod
    def _inertial(
        element: ET.Element,
        boxes: Sequence[tuple[Vector, Vector]],
        mass: float,
        origin: Sequence[float],
    ) -> None:
        low = [min(c[i] - s[i] / 2 for c, s in boxes) for i in range(3)]
        high = [max(c[i] + s[i] / 2 for c, s in boxes) for i in range(3)]
        x, y, z = (b - a for a, b in zip(low, high, strict=True))
        centre = [(a + b) / 2 - o for a, b, o in zip(low, high, origin, strict=True)]
        inertial = ET.SubElement(element, "inertial")
        ET.SubElement(inertial, "origin", xyz=_text(centre), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=_number(mass))
        moments = [mass / 12 * v for v in (y * y + z * z, x * x + z * z, x * x + y * y)]
        zero = {"ixy": "0", "ixz": "0", "iyz": "0"}
        diagonal = dict(zip(("ixx", "iyy", "izz"), map(_number, moments), strict=True))
        ET.SubElement(inertial, "inertia", {**diagonal, **zero})


def _number(value: float) -> str:
    return repr(float(value))


def _text(values: Sequence[float]) -> str:
    return " ".join(map(_number, values))
