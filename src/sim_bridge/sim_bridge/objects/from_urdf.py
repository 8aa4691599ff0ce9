"""From a URDF, as published or as generated, to an object model."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.transforms import transform, unit
from flowbothd_common.types import Array
from sim_bridge.mesh import Color
from sim_bridge.objects.model import Joint, Link, ObjectModel
from sim_bridge.urdf import Urdf, UrdfJoint, read_urdf

PALETTE: tuple[Color, ...] = (
    (0.80, 0.52, 0.27),
    (0.36, 0.55, 0.66),
    (0.62, 0.67, 0.36),
    (0.70, 0.42, 0.42),
    (0.52, 0.45, 0.65),
    (0.40, 0.62, 0.53),
)
STATIC_COLOR: Color = (0.74, 0.71, 0.66)


def model_from_urdf(source: str | Path, name: str, *, mode: str = "", seed: int = 0) -> ObjectModel:
    """Build the model of an object.

    The target joint is the movable joint that carries the largest box of visible parts.

    Raises:
        ObjectModelError: unreadable, a mesh is missing, a revolute or prismatic joint has no finite
            limits, or nothing can be opened.
    """
    urdf = read_urdf(source)
    zero = _zero_poses(urdf)
    joints = {
        joint.name: _movable(joint, zero[joint.child])
        for joint in urdf.joints.values()
        if _is_movable(joint, urdf)
    }
    if not joints:
        raise ObjectModelError(
            f"{name} has nothing to open",
            got={joint.name: joint.kind for joint in urdf.joints.values()},
            allowed="at least one revolute or prismatic joint with lower < upper",
        )
    links = _links(urdf, zero, joints)
    model = ObjectModel(name, mode, seed, links, joints, next(iter(joints)), urdf)
    return model.with_target(max(joints, key=lambda joint: _carried_size(model, joint)))


def _is_movable(joint: UrdfJoint, urdf: Urdf) -> bool:
    if joint.kind in ("fixed", "continuous"):
        return False
    if joint.kind not in ("revolute", "prismatic"):
        raise ObjectModelError(
            f"joint {joint.name} is of an unsupported kind",
            got=f"{joint.kind} in {urdf.source}",
            allowed="fixed, continuous, revolute, prismatic",
        )
    if not (np.isfinite(joint.lower) and np.isfinite(joint.upper)):
        raise ObjectModelError(
            f"joint {joint.name} has no finite limits, so closed and open are undefined",
            got=f"lower {joint.lower}, upper {joint.upper} in {urdf.source}",
            allowed='<limit lower="..." upper="..."/>, or type="continuous" to have it locked',
        )
    return joint.lower < joint.upper


def _movable(joint: UrdfJoint, pose: Array) -> Joint:
    axis = unit(pose[:3, :3] @ unit(joint.axis))
    sliding = joint.kind == "prismatic"
    # Plausible small furniture: a few newtons on a runner, a few hundredths of a newton metre on a
    # hinge.
    return Joint(
        joint.name,
        joint.kind,
        joint.child,
        axis,
        pose[:3, 3].copy(),
        joint.lower,
        joint.upper,
        friction=1.0 if sliding else 0.05,
        damping=4.0 if sliding else 0.05,
    )


def _zero_poses(urdf: Urdf) -> dict[str, Array]:
    poses = {urdf.root: np.eye(4)}
    waiting = list(urdf.joints.values())
    while waiting:
        ready = [joint for joint in waiting if joint.parent in poses]
        if not ready:
            raise ObjectModelError("joints form a ring", got=[joint.name for joint in waiting])
        for joint in ready:
            poses[joint.child] = poses[joint.parent] @ joint.origin
        waiting = [joint for joint in waiting if joint.child not in poses]
    return poses


def _links(urdf: Urdf, zero: dict[str, Array], joints: dict[str, Joint]) -> dict[str, Link]:
    links: dict[str, Link] = {}
    colors = {joint.child: PALETTE[i % len(PALETTE)] for i, joint in enumerate(joints.values())}
    for name, link in urdf.links.items():
        chain: list[str] = []
        color, above = STATIC_COLOR, urdf.joint_above(name)
        while above is not None:
            if above.name in joints:
                if not chain:
                    color = colors[above.child]
                chain.insert(0, above.name)
            above = urdf.joint_above(above.parent)
        meshes = [m.transformed(zero[name]) for shape in link.visuals for m in shape.meshes()]
        painted = tuple(type(m)(m.vertices, m.faces, m.color or color) for m in meshes)
        if painted:
            links[name] = Link(name, painted, tuple(chain))
    return links


def _carried_size(model: ObjectModel, joint: str) -> float:
    vertices = [link.mesh.vertices for link in model.links.values() if link.joints[-1:] == (joint,)]
    if not vertices:
        return 0.0
    points = np.concatenate(vertices)
    # The area of the largest face of the box: a thin door must not lose against a deep drawer.
    edges = np.sort(points.max(axis=0) - points.min(axis=0))
    return float(edges[1] * edges[2])


def standing_at(model: ObjectModel, x: float, y: float, yaw: float) -> Array:
    """T_base_object that puts the object's lowest point on the table at (x, y), turned by `yaw`."""
    cosine, sine = float(np.cos(yaw)), float(np.sin(yaw))
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return transform(np.round(rotation, 15), (x, y, -float(model.bounds()[0, 2])))
