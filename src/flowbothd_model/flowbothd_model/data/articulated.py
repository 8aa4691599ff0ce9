"""Articulated objects as triangle meshes with a joint tree, and the flow of their opening."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.types import Array

Ints = NDArray[np.int64]


class JointKind(StrEnum):
    """Motion of a link relative to its parent."""

    FIXED = "fixed"
    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"


@dataclass(frozen=True)
class LinkJoint:
    """The joint that carries one link.

    Attributes:
        parent: Index of the parent link, smaller than the link's own; -1 = the world.
        kind: How it moves.
        axis: (3,) unit vector, object frame with all joints at zero.
        point: (3,) a point on the rotation axis, same frame [m].
        lower: Closed position [rad] or [m].
        upper: Fully open position.
        name: For reports.
    """

    parent: int = -1
    kind: JointKind = JointKind.FIXED
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lower: float = 0.0
    upper: float = 0.0
    name: str = ""

    @property
    def movable(self) -> bool:
        """True for a joint that can open: revolute or prismatic, with a range."""
        return self.kind is not JointKind.FIXED and self.upper > self.lower


@dataclass(frozen=True)
class ArticulatedObject:
    """One object; link i is carried by joint i, parents come before children.

    Attributes:
        name: Identifies the object, e.g. its PartNet-Mobility id.
        category: One of the paper's 21 categories, as it spells them.
        vertices: (V, 3) float32, object frame with all joints at zero [m].
        faces: (F, 3) int64 indices of vertices.
        vertex_link: (V,) int64, the link of each vertex.
        joints: L joints.

    Raises:
        ObjectModelError: no faces, an index out of range, or a parent after its child.
    """

    name: str
    category: str
    vertices: NDArray[np.float32]
    faces: Ints
    vertex_link: Ints
    joints: tuple[LinkJoint, ...]

    def __post_init__(self) -> None:
        """Validate the indices."""
        if len(self.faces) == 0:
            raise ObjectModelError(f"object {self.name} has no faces")
        if self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise ObjectModelError(f"object {self.name} has faces with unknown vertices")
        if len(self.vertex_link) != len(self.vertices) or not (
            self.vertex_link.min() >= 0 and self.vertex_link.max() < len(self.joints)
        ):
            raise ObjectModelError(f"object {self.name} has vertices of unknown links")
        for index, joint in enumerate(self.joints):
            if joint.parent >= index:
                raise ObjectModelError(
                    f"object {self.name}: a joint's parent must come before it",
                    got=f"joint {index} with parent {joint.parent}",
                )

    @property
    def movable(self) -> list[int]:
        """Indices of the joints that open."""
        return [i for i, joint in enumerate(self.joints) if joint.movable]

    def closed(self) -> Array:
        """(L,) joint positions with everything closed; zero for fixed joints."""
        return np.array([j.lower if j.movable else 0.0 for j in self.joints])

    def poses(self, positions: Array) -> Array:
        """(L, 4, 4): where joint `positions` (L,) carry each link, object frame."""
        result = np.empty((len(self.joints), 4, 4))
        for index, joint in enumerate(self.joints):
            parent = np.eye(4) if joint.parent < 0 else result[joint.parent]
            result[index] = parent @ _motion(joint, float(positions[index]))
        return result

    def posed_vertices(self, positions: Array) -> NDArray[np.float32]:
        """(V, 3) float32 vertices with the joints at `positions` (L,)."""
        result = self.vertices.copy()
        for link, pose in enumerate(self.poses(positions).astype(np.float32)):
            own = self.vertex_link == link
            result[own] = self.vertices[own] @ pose[:3, :3].T + pose[:3, 3]
        return result

    def opening_twists(self, positions: Array) -> Array:
        """(L, 6): velocity of each link when every movable joint opens by 1 rad/s or 1 m/s.

        Rows are (omega, v), so that a point x of the link moves with omega x x + v. This is the
        published ground truth (all joints move at once, limits ignored) in the limit of a small
        motion; the published code uses steps of 0.01, which differ by under 1 %.
        """
        poses = self.poses(positions)
        twists = np.zeros((len(self.joints), 6))
        for index, joint in enumerate(self.joints):
            parent = np.eye(4) if joint.parent < 0 else poses[joint.parent]
            if joint.parent >= 0:
                twists[index] = twists[joint.parent]
            if not joint.movable:
                continue
            axis = parent[:3, :3] @ np.asarray(joint.axis)
            if joint.kind is JointKind.PRISMATIC:
                twists[index, 3:] += axis
            else:
                point = parent[:3, :3] @ np.asarray(joint.point) + parent[:3, 3]
                twists[index, :3] += axis
                twists[index, 3:] += np.cross(point, axis)
        return twists


def flow_of(twists: Array, links: Ints, points: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, 3) float32 velocity of `points` (N, 3) that belong to `links` (N,); not normalised."""
    chosen = twists[links]
    return np.asarray(np.cross(chosen[:, :3], points) + chosen[:, 3:], dtype=np.float32)


def max_normalised(flow: NDArray[np.float32]) -> NDArray[np.float32]:
    """`flow` (N, 3) divided by its largest norm plus 1e-6, as published."""
    return np.asarray(flow / (np.linalg.norm(flow, axis=1).max() + 1e-6), dtype=np.float32)


def _motion(joint: LinkJoint, position: float) -> Array:
    """(4, 4) that the joint applies at `position`."""
    result = np.eye(4)
    axis = np.asarray(joint.axis, dtype=float)
    if joint.kind is JointKind.PRISMATIC:
        result[:3, 3] = axis * position
    elif joint.kind is JointKind.REVOLUTE:
        result[:3, :3] = axis_rotation(axis, position)
        point = np.asarray(joint.point, dtype=float)
        result[:3, 3] = point - result[:3, :3] @ point
    return result


def axis_rotation(axis: Array, angle: float) -> Array:
    """(3, 3) rotation by `angle` [rad] about the unit vector `axis` (3,)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)
