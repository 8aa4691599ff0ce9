"""Articulated objects: links with meshes, movable joints with limits, kinematics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.transforms import rotation_about, transform
from flowbothd_common.types import Array
from sim_bridge.mesh import Mesh, merge
from sim_bridge.urdf import Urdf


@dataclass(frozen=True)
class Joint:
    """A movable joint as a screw in the object frame, taken while all joints are at zero.

    Attributes:
        name: As in the URDF.
        kind: revolute or prismatic.
        child: The link that it moves.
        axis: (3,) unit vector.
        point: (3,) a point on the axis [m]; unused for prismatic.
        lower: Closed [rad or m].
        upper: Open [rad or m].
        friction: Coulomb friction [Nm or N].
        damping: Viscous friction [Nms/rad or Ns/m].
    """

    name: str
    kind: str
    child: str
    axis: Array
    point: Array
    lower: float
    upper: float
    friction: float = 0.05
    damping: float = 0.05

    def motion(self, value: float) -> Array:
        """(4, 4) displacement of the child, in the object frame, from zero to `value`."""
        if self.kind == "prismatic":
            return transform(translation=self.axis * value)
        rotation = rotation_about(self.axis, value)
        return transform(rotation, self.point - rotation @ self.point)

    def open_ratio(self, value: float) -> float:
        """0 at the lower limit, 1 at the upper; beyond them less than 0 or more than 1."""
        return (value - self.lower) / (self.upper - self.lower)


@dataclass(frozen=True)
class Link:
    """A rigid part.

    Attributes:
        name: As in the URDF.
        meshes: What is seen, in the OBJECT frame while all joints are at zero. (So a part that has
            not moved is the same triangles whichever joint holds it.)
        joints: Names of the movable joints between the root and this link, root first.
    """

    name: str
    meshes: tuple[Mesh, ...]
    joints: tuple[str, ...]

    @property
    def mesh(self) -> Mesh:
        """All visual meshes as one."""
        return merge(list(self.meshes))


@dataclass(frozen=True)
class ObjectModel:
    """An object to be opened.

    Attributes:
        name: Registered name, or the folder's or file's name.
        mode: Chosen mode, empty for objects without modes.
        seed: The seed its proportions (and its mode, if drawn) came from.
        links: All links that have a shape.
        joints: Movable joints: revolute and prismatic with lower < upper. Continuous joints have no
            closed state: they are locked at zero and travel with their parent, as do joints whose
            range is empty.
        target_joint: The joint whose open ratio counts.
        alternatives: For objects that hide their mode: the joint of every mode, by mode name.
        default_pose: T_base_object where the arm can work on it.
        urdf: The source, for the physics.
    """

    name: str
    mode: str
    seed: int
    links: dict[str, Link]
    joints: dict[str, Joint]
    target_joint: str
    urdf: Urdf
    alternatives: dict[str, Joint] = field(default_factory=dict)
    default_pose: Array = field(default_factory=lambda: np.eye(4))

    @property
    def target(self) -> Joint:
        """The joint whose open ratio counts."""
        return self.joints[self.target_joint]

    def with_target(self, joint: str) -> ObjectModel:
        """Return the same object with another target joint (or the joint of a named link).

        Raises:
            ObjectModelError: not a movable joint, nor a link right below one.
        """
        by_link = {item.child: item.name for item in self.joints.values()}
        name = by_link.get(joint, joint)
        if name not in self.joints:
            raise ObjectModelError(
                f"{self.name} has no movable joint of that name",
                got=joint,
                allowed=list(self.joints),
            )
        return replace(self, target_joint=name)

    def closed(self) -> dict[str, float]:
        """Every movable joint at its lower limit."""
        return {joint.name: joint.lower for joint in self.joints.values()}

    def displacement(self, link: str, positions: Mapping[str, float]) -> Array:
        """(4, 4) motion of a link, in the object frame, from all joints at zero to `positions`."""
        matrix = np.eye(4)
        for name in self.links[link].joints:
            value = positions[name]
            # At exactly zero nothing is multiplied: an unmoved part keeps its coordinates exactly.
            if value != 0.0:
                matrix = matrix @ self.joints[name].motion(value)
        return matrix

    def displacements(self, positions: Mapping[str, float]) -> dict[str, Array]:
        """The displacement of every link."""
        return {name: self.displacement(name, positions) for name in self.links}

    def bounds(self, positions: Mapping[str, float] | None = None) -> Array:
        """(2, 3) lowest and highest corner in the object frame [m]; closed by default."""
        at = self.closed() if positions is None else positions
        corners = []
        for name, link in self.links.items():
            if len(link.mesh.vertices):
                moved = link.mesh.transformed(self.displacement(name, at)).vertices
                corners += [moved.min(axis=0), moved.max(axis=0)]
        return np.array([np.min(corners, axis=0), np.max(corners, axis=0)])
