"""Triangle meshes with a colour: read from files, or made from primitive shapes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.transforms import apply
from flowbothd_common.types import Array
from sim_bridge.collada import read_collada

Color = tuple[float, float, float]
"""Red, green, blue, 0..1."""

GREY: Color = (0.72, 0.72, 0.70)


@dataclass(frozen=True)
class Mesh:
    """Triangles of one colour.

    Attributes:
        vertices: (V, 3) float64 [m].
        faces: (F, 3) int32 indices into `vertices`.
        color: Surface colour, or None if the source names none.
    """

    vertices: Array
    faces: NDArray[np.int32]
    color: Color | None = None

    def transformed(self, matrix: Array) -> Mesh:
        """Return the mesh with its vertices mapped by a (4, 4) transform."""
        return Mesh(apply(matrix, self.vertices), self.faces, self.color)


def merge(meshes: list[Mesh]) -> Mesh:
    """Put several meshes into one; the colour is that of the first."""
    if not meshes:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(faces).astype(np.int32),
        meshes[0].color,
    )


def load_mesh(path: Path, scale: Array | None = None) -> list[Mesh]:
    """Read an .obj, .stl, .ply or .dae file.

    Args:
        path: The file.
        scale: (3,) factors for the vertices, as in URDF.

    Returns:
        One mesh per colour of a .dae file, one mesh for the others.

    Raises:
        ObjectModelError: the file is missing, of another kind, or holds no triangles.
    """
    if not path.is_file():
        raise ObjectModelError("mesh file is missing", got=path)
    if path.suffix.lower() == ".dae":
        meshes = [Mesh(part.vertices, part.faces, part.color) for part in read_collada(path)]
    else:
        meshes = [_load_with_trimesh(path)]
    if not any(len(mesh.faces) for mesh in meshes):
        raise ObjectModelError("mesh file holds no triangles", got=path)
    if scale is None:
        return meshes
    return [Mesh(mesh.vertices * scale, mesh.faces, mesh.color) for mesh in meshes]


def _load_with_trimesh(path: Path) -> Mesh:
    try:
        loaded: Any = trimesh.load(path, force="mesh", process=False, skip_materials=True)
    except (ValueError, KeyError, IndexError, NotImplementedError) as error:
        raise ObjectModelError(
            "mesh file cannot be read", got=f"{path} ({error})", allowed=".obj, .stl, .ply, .dae"
        ) from error
    return Mesh(
        np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3),
        np.asarray(loaded.faces, dtype=np.int32).reshape(-1, 3),
    )


def box_mesh(size: Array | tuple[float, float, float], color: Color | None = None) -> Mesh:
    """Box with the given edge lengths (x, y, z) [m], centred on the origin."""
    box = trimesh.creation.box(extents=np.asarray(size, dtype=float))
    return Mesh(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int32), color)


def cylinder_mesh(radius: float, length: float, color: Color | None = None) -> Mesh:
    """Cylinder along z, centred on the origin [m]."""
    shape = trimesh.creation.cylinder(radius=radius, height=length, sections=48)
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces, dtype=np.int32), color)


def sphere_mesh(radius: float, color: Color | None = None) -> Mesh:
    """Sphere centred on the origin [m]."""
    shape = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces, dtype=np.int32), color)
