"""PartNet-Mobility folders as articulated objects: reduced, or exactly as published."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.types import Array
from flowbothd_model.data.articulated import ArticulatedObject, Ints, JointKind, LinkJoint


def load_partnet(folder: Path, category: str | None = None) -> ArticulatedObject:
    """Read `folder/mobility.urdf` with its visual meshes.

    Args:
        folder: A PartNet-Mobility object; its name is the id.
        category: Overrides what meta.json says; "Unknown" where neither says anything.

    Raises:
        ObjectModelError: the folder has no readable URDF, a mesh is missing, or nothing moves.
    """
    urdf = folder / "mobility.urdf"
    try:
        root = ET.parse(urdf).getroot()
    except (OSError, ET.ParseError) as error:
        raise ObjectModelError(
            f"{folder.name} is not a PartNet-Mobility object",
            got=str(error),
            hint=f"expected {urdf.name}",
        ) from error
    children = {_text(j.find("child"), "link"): j for j in root.iter("joint")}
    elements = {str(link.get("name")): link for link in root.iter("link")}
    order = _parents_first(children, elements)
    frames: list[Array] = []
    joints: list[LinkJoint] = []
    vertices, faces, owner = [], [], []
    count = 0
    for index, name in enumerate(order):
        joint = children.get(name)
        parent = order.index(_text(joint.find("parent"), "link")) if joint is not None else -1
        above = frames[parent] if parent >= 0 else np.eye(4)
        frames.append(above @ _origin(joint) if joint is not None else above)
        joints.append(_link_joint(joint, parent, frames[-1]))
        for points, triangles in _visuals(folder, elements[name], frames[-1]):
            vertices.append(points)
            faces.append(triangles + count)
            owner.append(np.full(len(points), index, dtype=np.int64))
            count += len(points)
    if not vertices:
        raise ObjectModelError(f"{folder.name} has no visual meshes")
    item = ArticulatedObject(
        folder.name,
        category or _category(folder),
        np.concatenate(vertices).astype(np.float32),
        np.concatenate(faces),
        np.concatenate(owner),
        tuple(joints),
    )
    if not item.movable:
        raise ObjectModelError(f"{folder.name} has no movable joint")
    return item


def _category(folder: Path) -> str:
    """Return the category in meta.json, if there is one."""
    path = folder / "meta.json"
    if not path.is_file():
        return "Unknown"
    return str(json.loads(path.read_text(encoding="utf-8")).get("model_cat", "Unknown"))


def _parents_first(children: dict[str, ET.Element], elements: dict[str, ET.Element]) -> list[str]:
    """Link names so that every parent precedes its children."""
    order = [name for name in elements if name not in children]
    waiting = [name for name in elements if name in children]
    while waiting:
        ready = [n for n in waiting if _text(children[n].find("parent"), "link") in order]
        if not ready:
            raise ObjectModelError("the joints form a loop or name unknown links", got=waiting)
        order += ready
        waiting = [name for name in waiting if name not in ready]
    return order


def _link_joint(element: ET.Element | None, parent: int, frame: Array) -> LinkJoint:
    """The joint of one link; types other than revolute, continuous and prismatic are fixed."""
    kinds = {
        "revolute": JointKind.REVOLUTE,
        "continuous": JointKind.REVOLUTE,
        "prismatic": JointKind.PRISMATIC,
    }
    kind = kinds.get(str(element.get("type"))) if element is not None else None
    if element is None or kind is None:
        return LinkJoint(parent)
    axis_element, limit = element.find("axis"), element.find("limit")
    axis = _numbers(axis_element, "xyz", "1 0 0")
    axis = frame[:3, :3] @ (axis / np.linalg.norm(axis))
    lower = upper = 0.0
    if limit is not None:
        lower, upper = float(limit.get("lower", "0")), float(limit.get("upper", "0"))
    elif element.get("type") == "continuous":
        upper = 2 * np.pi
    return LinkJoint(
        parent, kind, _triple(axis), _triple(frame[:3, 3]), lower, upper, str(element.get("name"))
    )


def _visuals(folder: Path, link: ET.Element, frame: Array) -> list[tuple[Array, Ints]]:
    """Visual meshes of one link in the object frame."""
    result = []
    for visual in link.findall("visual"):
        mesh = visual.find("geometry/mesh")
        if mesh is None:
            continue
        points, triangles = read_obj(folder / str(mesh.get("filename")))
        points = points * _numbers(mesh, "scale", "1 1 1")
        pose = frame @ _origin(visual)
        result.append((points @ pose[:3, :3].T + pose[:3, 3], triangles))
    return [(points, triangles) for points, triangles in result if len(triangles)]


def read_obj(path: Path) -> tuple[Array, Ints]:
    """Vertices (V, 3) float64 and triangles (F, 3) of a Wavefront file; polygons become fans.

    Raises:
        ObjectModelError: the file is missing or not an OBJ file.
    """
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    try:
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("v "):
                vertices.append([float(value) for value in line.split()[1:4]])
            elif line.startswith("f "):
                corners = [int(corner.split("/")[0]) for corner in line.split()[1:]]
                corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
                faces += [
                    (corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1)
                ]
    except (OSError, ValueError) as error:
        raise ObjectModelError(f"mesh {path.name} cannot be read", got=str(error)) from error
    return np.array(vertices).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3)


def _origin(element: ET.Element) -> Array:
    """(4, 4) of a URDF origin; fixed-axis roll, pitch, yaw."""
    origin = element.find("origin")
    roll, pitch, yaw = _numbers(origin, "rpy", "0 0 0")
    cr, sr, cp, sp, cy, sy = (
        np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    )  # fmt: skip
    result = np.eye(4)
    result[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    result[:3, 3] = _numbers(origin, "xyz", "0 0 0")
    return result


def _numbers(element: ET.Element | None, key: str, default: str) -> Array:
    """Three numbers of an attribute, or the default; PartNet writes "None" for unknown ones."""
    text = element.get(key, default) if element is not None else default
    try:
        values = np.array([float(value) for value in text.split()])
    except ValueError:
        values = np.array([float(value) for value in default.split()])
    return values


def _triple(values: Array) -> tuple[float, float, float]:
    """Plain floats."""
    return float(values[0]), float(values[1]), float(values[2])


def _text(element: ET.Element | None, key: str) -> str:
    """An attribute that must be there."""
    value = element.get(key) if element is not None else None
    if value is None:
        raise ObjectModelError(f"a joint has no {key}")
    return value
