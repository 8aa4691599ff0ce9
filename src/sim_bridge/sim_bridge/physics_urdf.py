"""URDF for PyBullet: the joints and convex collision shapes of an object, or a robot."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from flowbothd_common.types import Array
from sim_bridge.mesh import Mesh, box_mesh, merge
from sim_bridge.objects.model import ObjectModel
from sim_bridge.urdf import Shape, UrdfJoint, UrdfLink

_DEFAULT_MASS = 1.0

_COVER_TOLERANCE = 0.01
"""How much smaller than the visible box of a link its collision meshes may be [m]."""

_MOST_PIECES = 32


@functools.cache
def scratch_folder() -> Path:
    """A folder of this process for generated files; removed when it ends."""
    folder = tempfile.TemporaryDirectory(prefix="sim_bridge_")
    atexit.register(folder.cleanup)
    return Path(folder.name)


def write_object(model: ObjectModel) -> Path:
    """Write the URDF of an object for PyBullet and return its path.

    Moving links get one convex hull per collision mesh (per connected visible part, where the
    collision meshes leave some of the link out), fixed ones the triangles that are seen.
    Every inertia is filled in (1 kg spread over the link's box where the source has none), joints
    that cannot be opened are fixed, visuals are left out.
    """
    folder = Path(tempfile.mkdtemp(dir=scratch_folder()))
    robot = ET.Element("robot", name=model.name)
    root = model.urdf.root
    moving = {name for name, part in model.links.items() if part.joints}
    for link in model.urdf.links.values():
        element = ET.SubElement(robot, "link", name=link.name)
        static = link.name not in moving
        points = _collisions(element, link, folder, static=static)
        _inertial(element, link, points, is_root=link.name == root)
    for joint in model.urdf.joints.values():
        _joint(robot, joint, movable=joint.name in model.joints)
    return _write(robot, folder / "object.urdf")


def remove(path: Path) -> None:
    """Remove what `write_object` or `write_robot` wrote; harmless if it is gone."""
    shutil.rmtree(path.parent, ignore_errors=True)


def write_robot(urdf_text: str) -> Path:
    """Write a robot's URDF without its visuals, which PyBullet would load for half a second."""
    robot = ET.fromstring(urdf_text)
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    return _write(robot, Path(tempfile.mkdtemp(dir=scratch_folder())) / "robot.urdf")


def _write(robot: ET.Element, path: Path) -> Path:
    # PyBullet reads lines of 1024 characters and puts a line break after each, wherever that is.
    ET.indent(robot)
    ET.ElementTree(robot).write(path)
    return path


def _collisions(link: ET.Element, source: UrdfLink, folder: Path, *, static: bool) -> Array:
    """Add the collision shapes of a link; returns their corner points (N, 3) in the link frame."""
    felt = [mesh for shape in source.collisions for mesh in shape.meshes()]
    seen = [mesh for shape in source.visuals for mesh in shape.meshes()]
    if all(shape.kind != "mesh" for shape in (*source.collisions, *source.visuals)):
        for shape in source.collisions:
            _primitive(link, shape)
        return merge(felt).vertices
    if static:
        # The hull of a door frame would close the very opening that its leaf stands in.
        whole = merge(seen or felt)
        pieces = [(whole.vertices, whole.faces.tolist())]
    else:
        solid = felt if _covers(felt, seen) else _connected(merge(seen))
        pieces = [_hull(mesh.vertices) for mesh in solid]
    if pieces:
        _mesh_collision(link, pieces, folder, concave=static)
    return np.concatenate([np.zeros((0, 3)), *(vertices for vertices, _ in pieces)])


def _covers(felt: list[Mesh], seen: list[Mesh]) -> bool:
    """Return True if collision meshes cover the visual ones; some published ones do not."""
    if not felt or not seen:
        return bool(felt)
    solid, visible = merge(felt).vertices, merge(seen).vertices
    short = np.maximum(
        solid.min(axis=0) - visible.min(axis=0), visible.max(axis=0) - solid.max(axis=0)
    )
    return bool(short.max() < _COVER_TOLERANCE)


def _connected(mesh: Mesh) -> list[Mesh]:
    """The parts of a mesh that do not hang together; the whole if they are too many.

    (Decimated meshes may be a soup of triangles, in which connection means nothing.)
    """
    joined = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    nodes = np.arange(len(joined.faces))
    parts = trimesh.graph.connected_components(joined.face_adjacency, nodes=nodes)
    if len(parts) > _MOST_PIECES:
        return [mesh]
    vertices = np.asarray(joined.vertices, dtype=np.float64)
    faces = np.asarray(joined.faces, dtype=np.int32)
    return [Mesh(vertices[np.unique(faces[part])], faces[:0]) for part in parts]


def _mesh_collision(
    link: ET.Element, pieces: list[tuple[Array, list[list[int]]]], folder: Path, *, concave: bool
) -> None:
    """One file with one object per piece, which Bullet makes a compound of."""
    lines: list[str] = []
    count = 1
    for number, (vertices, faces) in enumerate(pieces):
        lines += [f"o piece_{number}"]
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
        lines += [f"f {a + count} {b + count} {c + count}" for a, b, c in faces]
        count += len(vertices)
    path = folder / f"{link.get('name')}.obj"
    path.write_text("\n".join(lines) + "\n")
    collision = ET.SubElement(link, "collision", {"concave": "yes"} if concave else {})
    ET.SubElement(ET.SubElement(collision, "geometry"), "mesh", filename=str(path))


def _primitive(link: ET.Element, shape: Shape) -> None:
    collision = ET.SubElement(link, "collision")
    ET.SubElement(collision, "origin", xyz=_text(shape.origin[:3, 3]), rpy=_rpy(shape.origin))
    keys = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}[shape.kind]
    values = [_text(shape.size)] if shape.kind == "box" else [_text([v]) for v in shape.size]
    geometry = ET.SubElement(collision, "geometry")
    ET.SubElement(geometry, shape.kind, dict(zip(keys, values, strict=True)))


def _hull(points: Array) -> tuple[Array, list[list[int]]]:
    """Convex hull; flat shapes become thin boxes."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        low, high = points.min(axis=0), points.max(axis=0)
        box = box_mesh(np.maximum(high - low, 1e-3))
        return box.vertices + (low + high) / 2, box.faces.tolist()
    index = {int(old): new for new, old in enumerate(hull.vertices)}
    faces = [[index[a], index[b], index[c]] for a, b, c in hull.simplices.tolist()]
    return np.asarray(points[hull.vertices]), faces


def _inertial(element: ET.Element, link: UrdfLink, shape: Array, *, is_root: bool) -> None:
    inertial = ET.SubElement(element, "inertial")
    mass = link.mass if link.mass and link.mass > 0 else _DEFAULT_MASS
    turn = link.com[:3, :3]
    centre, inertia = link.com[:3, 3], turn @ link.inertia @ turn.T
    if not (link.mass and link.mass > 0):
        points = shape if len(shape) else np.array([[-0.05] * 3, [0.05] * 3])
        low, high = points.min(axis=0), points.max(axis=0)
        x, y, z = np.maximum(high - low, 0.01)
        centre = (low + high) / 2
        inertia = np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) * mass / 12
    # PyBullet places a body by the mass centre of its root: with it at the link's origin, base
    # pose and link frame are the same. The root is fixed, its inertia does not matter.
    where = np.zeros(3) if is_root else centre
    ET.SubElement(inertial, "origin", xyz=_text(where), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(float(mass)))
    at = {"x": 0, "y": 1, "z": 2}
    pairs = ("xx", "yy", "zz", "xy", "xz", "yz")
    values = {f"i{pair}": repr(float(inertia[at[pair[0]], at[pair[1]]])) for pair in pairs}
    ET.SubElement(inertial, "inertia", values)


def _joint(robot: ET.Element, joint: UrdfJoint, *, movable: bool) -> None:
    kind = joint.kind if movable else "fixed"
    element = ET.SubElement(robot, "joint", name=joint.name, type=kind)
    xyz, rpy = _text(joint.origin[:3, 3]), _rpy(joint.origin)
    ET.SubElement(element, "origin", xyz=xyz, rpy=rpy)
    ET.SubElement(element, "parent", link=joint.parent)
    ET.SubElement(element, "child", link=joint.child)
    ET.SubElement(element, "axis", xyz=_text(joint.axis))
    if movable:
        limits = {"lower": repr(float(joint.lower)), "upper": repr(float(joint.upper))}
        ET.SubElement(element, "limit", {**limits, "effort": "1000", "velocity": "100"})


def _rpy(matrix: Array) -> str:
    """Fixed-axis roll, pitch, yaw of a (4, 4) transform, as URDF wants them."""
    r = matrix[:3, :3]
    pitch = float(np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0])))
    if np.hypot(r[0, 0], r[1, 0]) < 1e-9:
        # Looking straight up or down only the difference of roll and yaw counts.
        return _text([np.arctan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return _text([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
