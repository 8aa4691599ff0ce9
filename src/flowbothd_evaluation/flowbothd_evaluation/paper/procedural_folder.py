"""Objects made by rule as folders that the simulation can load, like a downloaded object."""

from __future__ import annotations

import functools
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from flowbothd_common.types import Array
from flowbothd_model.data.articulated import ArticulatedObject, JointKind
from flowbothd_model.data.procedural.catalogue import make
from sim_bridge.physics_urdf import scratch_folder

_ROOT = "base"


@functools.lru_cache(maxsize=64)
def make_object(name: str) -> Path:
    """Folder with the object `category-number`; it goes when the process ends."""
    category, _, number = name.rpartition("-")
    folder = scratch_folder() / name
    folder.mkdir()
    write_folder(make(category, int(number)), folder)
    return folder


def write_folder(thing: ArticulatedObject, folder: Path) -> None:
    """Write mobility.urdf and one mesh a link.

    The frame of a link stands, unturned, on the axis of its joint, so that poses are sums.
    """
    robot = ET.Element("robot", name=thing.name)
    ET.SubElement(robot, "link", name=_ROOT)
    # A joint that cannot move may stand anywhere; with its parent is simplest.
    origins: list[Array] = []
    for index, joint in enumerate(thing.joints):
        above = origins[joint.parent] if joint.parent >= 0 else np.zeros(3)
        origins.append(np.asarray(joint.point, dtype=float) if joint.movable else above)
        _link(robot, thing, index, origins[-1], folder)
        kind = joint.kind if joint.movable else JointKind.FIXED
        element = ET.SubElement(robot, "joint", name=f"joint_{index}", type=kind.value)
        ET.SubElement(element, "origin", xyz=_text(origins[-1] - above), rpy="0 0 0")
        parent = _ROOT if joint.parent < 0 else f"link_{joint.parent}"
        ET.SubElement(element, "parent", link=parent)
        ET.SubElement(element, "child", link=f"link_{index}")
        ET.SubElement(element, "axis", xyz=_text(np.asarray(joint.axis, dtype=float)))
        if joint.movable:
            limits = {"lower": repr(float(joint.lower)), "upper": repr(float(joint.upper))}
            ET.SubElement(element, "limit", {**limits, "effort": "1000", "velocity": "100"})
    ET.indent(robot)
    ET.ElementTree(robot).write(folder / "mobility.urdf")


def _link(
    robot: ET.Element, thing: ArticulatedObject, index: int, origin: Array, folder: Path
) -> None:
    link = ET.SubElement(robot, "link", name=f"link_{index}")
    faces = thing.faces[thing.vertex_link[thing.faces[:, 0]] == index]
    if not len(faces):
        return
    used, renumbered = np.unique(faces, return_inverse=True)
    vertices = thing.vertices[used].astype(float) - origin
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (renumbered.reshape(-1, 3) + 1).tolist()]
    file = folder / f"link_{index}.obj"
    file.write_text("\n".join(lines) + "\n")
    geometry = ET.SubElement(ET.SubElement(link, "visual"), "geometry")
    ET.SubElement(geometry, "mesh", filename=file.name)


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
