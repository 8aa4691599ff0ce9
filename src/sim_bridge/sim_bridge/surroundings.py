"""Contents of the arm's world except the object: the table, and the robot's appearance."""

from __future__ import annotations

import functools

import numpy as np

from sim_bridge.mesh import Mesh, box_mesh
from sim_bridge.scene import Part
from sim_bridge.urdf import read_urdf

TABLE_LOW = np.array([-0.45, -0.85, -0.04])
"""Lowest corner of the table in base [m]."""

TABLE_HIGH = np.array([1.25, 0.85, 0.0])
"""Highest corner of the table in base [m]."""

_TABLE_COLOR = (0.62, 0.60, 0.57)


@functools.lru_cache(maxsize=4)
def robot_meshes(urdf_text: str) -> dict[str, tuple[Mesh, ...]]:
    """Visual meshes of a robot's links in their link frames, by link name."""
    urdf = read_urdf(urdf_text)
    found = {
        name: tuple(mesh for shape in link.visuals for mesh in shape.meshes())
        for name, link in urdf.links.items()
    }
    return {name: meshes for name, meshes in found.items() if meshes}


@functools.lru_cache(maxsize=4)
def static_parts(urdf_text: str) -> tuple[Part, ...]:
    """Table and robot; the same objects at every call, so that cameras can keep their scenes."""
    middle = (TABLE_LOW + TABLE_HIGH) / 2
    top = box_mesh(TABLE_HIGH - TABLE_LOW, _TABLE_COLOR)
    table = Part("table", (Mesh(top.vertices + middle, top.faces, top.color),))
    return (table, *(Part(f"robot/{n}", m) for n, m in robot_meshes(urdf_text).items()))
