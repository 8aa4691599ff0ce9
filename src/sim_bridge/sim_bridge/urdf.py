"""Reading URDF as it is found: links with their shapes, joints with their limits."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.transforms import rotation_from_rpy, transform
from flowbothd_common.types import Array
from sim_bridge.mesh import Color, Mesh, box_mesh, cylinder_mesh, load_mesh, sphere_mesh


@dataclass(frozen=True)
class Shape:
    """One <visual> or <collision>.

    Attributes:
        kind: mesh, box, cylinder or sphere.
        origin: (4, 4) T_link_shape.
        size: Box: edges; cylinder: radius, length; sphere: radius; mesh: scale.
        path: Mesh file, absolute; None for the primitives.
        color: From <material>, or None.
    """

    kind: str
    origin: Array
    size: tuple[float, ...]
    path: Path | None = None
    color: Color | None = None

    def meshes(self) -> list[Mesh]:
        """Triangles of this shape in the link frame."""
        if self.kind == "box":
            found = [box_mesh((self.size[0], self.size[1], self.size[2]))]
        elif self.kind == "cylinder":
            found = [cylinder_mesh(self.size[0], self.size[1])]
        elif self.kind == "sphere":
            found = [sphere_mesh(self.size[0])]
        else:
            found = load_mesh(self.path or Path(), np.asarray(self.size))
        return [
            Mesh(moved.vertices, moved.faces, self.color or moved.color)
            for moved in (mesh.transformed(self.origin) for mesh in found)
        ]


@dataclass(frozen=True)
class UrdfLink:
    """A link; `mass` is None where the file has no <inertial>."""

    name: str
    visuals: tuple[Shape, ...]
    collisions: tuple[Shape, ...]
    mass: float | None
    com: Array
    inertia: Array


@dataclass(frozen=True)
class UrdfJoint:
    """A joint; `lower` and `upper` are NaN where the file has no <limit>."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Array
    axis: Array
    lower: float
    upper: float
    effort: float


@dataclass(frozen=True)
class Urdf:
    """A parsed file: links and joints by name, in the order of the file."""

    name: str
    links: dict[str, UrdfLink]
    joints: dict[str, UrdfJoint]
    source: str

    @property
    def root(self) -> str:
        """Name of the link without a parent."""
        children = {joint.child for joint in self.joints.values()}
        return next(name for name in self.links if name not in children)

    def joint_above(self, link: str) -> UrdfJoint | None:
        """The joint whose child is `link`, or None for the root."""
        return next((joint for joint in self.joints.values() if joint.child == link), None)


def read_urdf(source: str | Path) -> Urdf:
    """Parse a URDF file or text.

    Args:
        source: Path of a file, or the XML itself (then mesh paths must be absolute).

    Returns:
        The model. Every mesh file exists; nothing has been loaded from it yet.

    Raises:
        ObjectModelError: no such file, not a URDF, a mesh is missing (with line and link), links
            and joints do not form one tree.
    """
    text, folder, label = _text(source)
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ObjectModelError("URDF is not valid XML", got=f"{label}: {error}") from error
    if root.tag != "robot":
        raise ObjectModelError("not a URDF", got=f"<{root.tag}> in {label}", allowed="<robot>")
    reader = _Reader(text, folder, label, _materials(root))
    links = {link.name: link for link in map(reader.link, root.findall("link"))}
    joints = {joint.name: joint for joint in map(reader.joint, root.findall("joint"))}
    model = Urdf(root.get("name", "unnamed"), links, joints, label)
    _check_tree(model)
    return model


def _text(source: str | Path) -> tuple[str, Path | None, str]:
    if isinstance(source, str) and source.lstrip().startswith("<"):
        return source, None, "the given URDF text"
    path = Path(source)
    try:
        return path.read_text(encoding="utf-8"), path.resolve().parent, str(path)
    except (OSError, UnicodeDecodeError) as error:
        raise ObjectModelError("URDF cannot be read", got=f"{path} ({error})") from error


def _materials(root: ET.Element) -> dict[str, Color]:
    colors = {}
    for material in root.findall("material"):
        color = _color(material, {})
        if color is not None:
            colors[material.get("name", "")] = color
    return colors


def _color(material: ET.Element | None, named: dict[str, Color]) -> Color | None:
    if material is None:
        return None
    entry = material.find("color")
    if entry is None:
        return named.get(material.get("name", ""))
    red, green, blue = _numbers(entry.get("rgba", "1 1 1 1"))[:3]
    return float(red), float(green), float(blue)


def _numbers(text: str) -> Array:
    return np.array([float(value) for value in text.split()])


def _check_tree(model: Urdf) -> None:
    if not model.links:
        raise ObjectModelError("URDF has no links", got=model.source)
    for joint in model.joints.values():
        for link in (joint.parent, joint.child):
            if link not in model.links:
                raise ObjectModelError(
                    f"joint {joint.name} names a link that does not exist",
                    got=link,
                    allowed=sorted(model.links),
                )
    children = [joint.child for joint in model.joints.values()]
    roots = [name for name in model.links if name not in children]
    if len(roots) != 1 or len(set(children)) != len(children):
        raise ObjectModelError(
            "links and joints do not form one tree",
            got=f"roots {roots} in {model.source}",
            allowed="one root, one parent per link",
        )


class _Reader:
    """Turns elements into values; knows the text, so that errors can tell the line."""

    def __init__(self, text: str, folder: Path | None, label: str, colors: dict[str, Color]):
        self._text = text
        self._folder = folder
        self._label = label
        self._colors = colors

    def link(self, element: ET.Element) -> UrdfLink:
        name = element.get("name", "")
        mass, com, inertia = self._inertial(element.find("inertial"))
        return UrdfLink(
            name,
            tuple(self._shape(item, name) for item in element.findall("visual")),
            tuple(self._shape(item, name) for item in element.findall("collision")),
            mass,
            com,
            inertia,
        )

    def joint(self, element: ET.Element) -> UrdfJoint:
        name, kind = element.get("name", ""), element.get("type", "")
        limit = element.find("limit")
        axis = element.find("axis")
        parent, child = element.find("parent"), element.find("child")
        if parent is None or child is None:
            raise ObjectModelError(
                f"joint {name} lacks <parent> or <child>", got=f"line {self._line(name)}"
            )
        return UrdfJoint(
            name,
            kind,
            parent.get("link", ""),
            child.get("link", ""),
            _origin(element.find("origin")),
            _numbers("1 0 0" if axis is None else axis.get("xyz", "1 0 0")),
            float("nan") if limit is None else float(limit.get("lower", "nan")),
            float("nan") if limit is None else float(limit.get("upper", "nan")),
            0.0 if limit is None else float(limit.get("effort", "0")),
        )

    def _inertial(self, element: ET.Element | None) -> tuple[float | None, Array, Array]:
        if element is None:
            return None, np.eye(4), np.eye(3)
        mass, tensor = element.find("mass"), element.find("inertia")
        inertia = np.eye(3)
        if tensor is not None:
            for row, first in enumerate("xyz"):
                for column, second in enumerate("xyz"):
                    key = "i" + "".join(sorted(first + second))
                    inertia[row, column] = float(tensor.get(key, "0"))
        value = None if mass is None else float(mass.get("value", "0"))
        return value, _origin(element.find("origin")), inertia

    def _shape(self, element: ET.Element, link: str) -> Shape:
        origin = _origin(element.find("origin"))
        color = _color(element.find("material"), self._colors)
        for kind, keys in (
            ("box", ("size",)),
            ("cylinder", ("radius", "length")),
            ("sphere", ("radius",)),
        ):
            item = element.find(f"geometry/{kind}")
            if item is not None:
                size = [v for key in keys for v in _numbers(item.get(key, ""))]
                return Shape(kind, origin, tuple(size), None, color)
        item = element.find("geometry/mesh")
        if item is None:
            raise ObjectModelError(
                f"link {link} has a shape of an unknown kind",
                got=self._label,
                allowed="mesh, box, cylinder, sphere",
            )
        scale = tuple(_numbers(item.get("scale", "1 1 1")))
        return Shape("mesh", origin, scale, self._mesh_path(item.get("filename", ""), link), color)

    def _mesh_path(self, filename: str, link: str) -> Path:
        path = Path(filename.removeprefix("file://"))
        if not path.is_absolute() and self._folder is not None:
            path = self._folder / path
        if not path.is_file():
            raise ObjectModelError(
                f"mesh file of link {link} is missing",
                got=f"{filename} (line {self._line(filename)} of {self._label})",
                hint="copy the whole object folder, or fix the <mesh filename>",
            )
        return path

    def _line(self, token: str) -> int:
        return self._text[: max(self._text.find(f'"{token}"'), 0)].count("\n") + 1


def _origin(element: ET.Element | None) -> Array:
    if element is None:
        return np.eye(4)
    return transform(
        rotation_from_rpy(_numbers(element.get("rpy", "0 0 0"))),
        _numbers(element.get("xyz", "0 0 0")),
    )
