"""A reader for the part of COLLADA that robot meshes use: triangles, matrices, diffuse colours.

Neither Open3D nor trimesh reads .dae without further packages, and PyBullet does not hand out
visual meshes, but the camera has to see the robot as it looks.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.types import Array

_NS = "{http://www.collada.org/2005/11/COLLADASchema}"


@dataclass(frozen=True)
class ColladaPart:
    """Triangles of one material.

    Attributes:
        vertices: (V, 3) [m], z up.
        faces: (F, 3) indices.
        color: Diffuse red, green, blue 0..1, or None.
    """

    vertices: Array
    faces: NDArray[np.int32]
    color: tuple[float, float, float] | None


def read_collada(path: Path) -> list[ColladaPart]:
    """Read all triangles of a .dae file in metres, z up.

    Raises:
        ObjectModelError: not XML, or polygons that are not triangles.
    """
    try:
        root = ET.parse(path).getroot()
    except ET.ParseError as error:
        raise ObjectModelError("mesh file is not valid XML", got=f"{path}: {error}") from error
    scale = _unit(root)
    upright = _upright(root)
    colors = _material_colors(root)
    geometries = {g.get("id", ""): g for g in root.iter(f"{_NS}geometry")}
    parts: list[ColladaPart] = []
    for scene in root.iter(f"{_NS}visual_scene"):
        for node in scene.findall(f"{_NS}node"):
            _collect(node, upright, geometries, colors, path, parts)
    return [ColladaPart(part.vertices * scale, part.faces, part.color) for part in parts]


def _unit(root: ET.Element) -> float:
    unit = root.find(f"{_NS}asset/{_NS}unit")
    return 1.0 if unit is None else float(unit.get("meter", "1"))


def _upright(root: ET.Element) -> Array:
    matrix = np.eye(4)
    axis = root.findtext(f"{_NS}asset/{_NS}up_axis", "Y_UP").strip()
    if axis == "Y_UP":
        matrix[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    return matrix


def _material_colors(root: ET.Element) -> dict[str, tuple[float, float, float]]:
    effects = {}
    for effect in root.iter(f"{_NS}effect"):
        color = effect.find(f".//{_NS}diffuse/{_NS}color")
        if color is not None and color.text:
            red, green, blue = (float(v) for v in color.text.split()[:3])
            effects[effect.get("id", "")] = (red, green, blue)
    colors = {}
    for material in root.iter(f"{_NS}material"):
        instance = material.find(f"{_NS}instance_effect")
        name = "" if instance is None else instance.get("url", "").lstrip("#")
        if name in effects:
            colors[material.get("id", "")] = effects[name]
    return colors


def _collect(
    node: ET.Element,
    above: Array,
    geometries: dict[str, ET.Element],
    colors: dict[str, tuple[float, float, float]],
    path: Path,
    parts: list[ColladaPart],
) -> None:
    matrix = above
    for child in node.findall(f"{_NS}matrix"):
        matrix = matrix @ np.array([float(v) for v in (child.text or "").split()]).reshape(4, 4)
    for instance in node.findall(f"{_NS}instance_geometry"):
        geometry = geometries.get(instance.get("url", "").lstrip("#"))
        if geometry is not None:
            bound = {
                m.get("symbol", ""): m.get("target", "").lstrip("#")
                for m in instance.iter(f"{_NS}instance_material")
            }
            parts.extend(_geometry_parts(geometry, matrix, bound, colors, path))
    for child in node.findall(f"{_NS}node"):
        _collect(child, matrix, geometries, colors, path, parts)


def _geometry_parts(
    geometry: ET.Element,
    matrix: Array,
    bound: dict[str, str],
    colors: dict[str, tuple[float, float, float]],
    path: Path,
) -> list[ColladaPart]:
    mesh = geometry.find(f"{_NS}mesh")
    if mesh is None:
        return []
    for kind in ("polylist", "polygons", "tristrips", "trifans"):
        if mesh.find(f"{_NS}{kind}") is not None:
            raise ObjectModelError(
                "mesh file has polygons of an unsupported kind",
                got=f"<{kind}> in {path}",
                allowed="<triangles>",
                hint="export it triangulated",
            )
    parts = []
    for triangles in mesh.findall(f"{_NS}triangles"):
        vertices, faces = _triangles(mesh, triangles)
        moved = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        symbol = triangles.get("material", "")
        parts.append(ColladaPart(moved, faces, colors.get(bound.get(symbol, symbol))))
    return parts


def _triangles(mesh: ET.Element, triangles: ET.Element) -> tuple[Array, NDArray[np.int32]]:
    inputs = triangles.findall(f"{_NS}input")
    stride = 1 + max(int(i.get("offset", "0")) for i in inputs)
    vertex = next(i for i in inputs if i.get("semantic") == "VERTEX")
    indices = np.array((triangles.findtext(f"{_NS}p") or "").split(), dtype=np.int64)
    faces = indices.reshape(-1, stride)[:, int(vertex.get("offset", "0"))].reshape(-1, 3)
    vertices_id = vertex.get("source", "").lstrip("#")
    bundle = next(v for v in mesh.findall(f"{_NS}vertices") if v.get("id") == vertices_id)
    position = next(i for i in bundle.findall(f"{_NS}input") if i.get("semantic") == "POSITION")
    source_id = position.get("source", "").lstrip("#")
    source = next(s for s in mesh.findall(f"{_NS}source") if s.get("id") == source_id)
    numbers = np.array((source.findtext(f"{_NS}float_array") or "").split(), dtype=float)
    return numbers.reshape(-1, 3), faces.astype(np.int32)
