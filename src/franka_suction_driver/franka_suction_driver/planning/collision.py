"""Collision checks of the arm with itself, the table, boxes and an observed cloud, by coal.

Link meshes are replaced by their convex hulls, the cloud by an octree: a configuration is then
checked in some fifty microseconds, margins included.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import coal
import numpy as np
import pinocchio

from flowbothd_common.errors import ParameterError
from flowbothd_common.types import Array, Cloud, as_cloud
from franka_suction_driver.arm.kinematics import Kinematics

TABLE = "table"
CLOUD = "cloud"
HIDDEN = "what the cloud may hide"
WORKSPACE = "the edge of the workspace"
"""Names of things other than boxes, as messages show them."""
_TABLE_SIZE = (4.0, 4.0, 0.1)
"""Extents of the table's box [m]: wider than any arm reaches, thick enough that no link passes
through it between two checked configurations."""


@dataclass(frozen=True)
class Box:
    """A solid box to keep away from.

    Attributes:
        name: For messages.
        size: Full extents along its own axes [m].
        pose: (4, 4) T_base_box of its centre.
    """

    name: str
    size: tuple[float, float, float]
    pose: Array = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True)
class Margins:
    """Distances below which two things count as touching [m]."""

    self_collision: float = 0.005
    table: float = 0.01
    scene: float = 0.015


@dataclass(frozen=True)
class ContactPair:
    """Two things that are closer than their margin."""

    first: str
    second: str

    def __str__(self) -> str:
        """For messages."""
        return f"{self.first} with {self.second}"


class CollisionChecker:
    """Tells whether a configuration is free; the scene can be changed between checks.

    Args:
        kinematics: The arm; its URDF supplies the collision geometry.
        margins: Kept distances.
        table_height: Top of the table in base [m], None = no table.
        cell: Edge of the cells that the cloud is turned into [m].
        workspace: Low and high corner (3,) of the box that the tip stays in [m], None = no box.

    Raises:
        ParameterError: a mesh of the robot cannot be loaded, or `cell` is not positive.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        margins: Margins | None = None,
        *,
        table_height: float | None = 0.0,
        cell: float = 0.015,
        workspace: tuple[Array, Array] | None = None,
    ) -> None:
        if not cell > 0:
            raise ParameterError("size of an obstacle cell", got=cell, allowed="> 0 m")
        self._kinematics = kinematics
        self._margins = margins or Margins()
        self._scene_margin = self._margins.scene
        self._cell = cell
        self._workspace = workspace
        self._data = kinematics.model.createData()
        self._robot = _convex_robot(kinematics)
        model = kinematics.model
        self._base = model.frames[model.getFrameId(kinematics.base_frame)].placement
        self._table = None if table_height is None else _table(table_height)
        self._boxes: tuple[Box, ...] = ()
        self._cloud: Cloud | None = None
        self._hidden: Cloud | None = None
        self._allowed: tuple[str, ...] = ()
        self._rebuild()

    @property
    def scene_margin(self) -> float:
        """Distance now kept from boxes and cloud [m]."""
        return self._scene_margin

    @contextmanager
    def with_scene_margin(self, margin: float) -> Iterator[None]:
        """Keep another distance from boxes and cloud [m] within a `with` block."""
        before = self._scene_margin
        self._set_scene_margin(margin)
        try:
            yield
        finally:
            self._set_scene_margin(before)

    @contextmanager
    def with_boxes(self, boxes: Iterable[Box]) -> Iterator[None]:
        """Put other boxes in the place of the present ones within a `with` block."""
        before = self._boxes
        self.set_boxes(boxes)
        try:
            yield
        finally:
            self.set_boxes(before)

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the robot's links that have a shape."""
        return tuple(dict.fromkeys(_link_name(o.name) for o in self._robot.geometryObjects))

    def set_boxes(self, boxes: Iterable[Box]) -> None:
        """Replace the boxes."""
        self._boxes = tuple(boxes)
        self._rebuild()

    def move_box(self, name: str, pose: Array) -> None:
        """Put a box elsewhere: (4, 4) T_base_box.

        Raises:
            ParameterError: there is no box of that name.
        """
        if name not in [box.name for box in self._boxes]:
            raise ParameterError("unknown box", got=name, allowed=[b.name for b in self._boxes])
        index = self._geometry.getGeometryId(name)
        self._geometry.geometryObjects[index].placement = self._base * pinocchio.SE3(
            pose[:3, :3], pose[:3, 3]
        )

    @property
    def points(self) -> Cloud | None:
        """The observed cloud, (N, 3) in base, or None."""
        return self._cloud

    def set_points(self, points: object | None, hidden: object | None = None) -> None:
        """Replace the observed cloud and what it is presumed to hide; None or no points clears.

        Args:
            points: (N, 3) in base [m].
            hidden: (M, 3) in base [m]; does not count where contact is allowed.

        Raises:
            InvalidCloudError: wrong shape, or values that are not finite.
        """
        self._cloud = _some(points, "obstacle cloud")
        self._hidden = _some(hidden, "hidden obstacles")
        self._rebuild()

    def touch(self, q: Array, *, contact_links: Sequence[str] = ()) -> ContactPair | None:
        """The first two things found closer than their margin, or None.

        Args:
            q: (J,) joint positions [rad].
            contact_links: Robot links that may touch the scene (boxes and cloud). If there are
                any, all links may be where something is only presumed to be hidden: one has to
                go there to touch.
        """
        self._allow(tuple(contact_links))
        if not self._inside(q):
            return self._edge()
        hit = pinocchio.computeCollisions(
            self._kinematics.model, self._data, self._geometry, self._geometry_data, q, True
        )
        if not hit:
            return None
        for pair, result in zip(
            self._geometry.collisionPairs, self._geometry_data.collisionResults, strict=True
        ):
            if result.isCollision():
                objects = self._geometry.geometryObjects
                return ContactPair(
                    _link_name(objects[pair.first].name), _link_name(objects[pair.second].name)
                )
        return ContactPair("the arm", "something")

    def touches(self, q: Array) -> frozenset[ContactPair]:
        """All pairs of things that are closer than their margin at joint positions (J,)."""
        self._allow(())
        pinocchio.computeCollisions(
            self._kinematics.model, self._data, self._geometry, self._geometry_data, q, False
        )
        objects = self._geometry.geometryObjects
        outside = frozenset() if self._inside(q) else frozenset([self._edge()])
        return outside | frozenset(
            ContactPair(_link_name(objects[pair.first].name), _link_name(objects[pair.second].name))
            for pair, result in zip(
                self._geometry.collisionPairs, self._geometry_data.collisionResults, strict=True
            )
            if result.isCollision()
        )

    def free(self, q: Array, *, contact_links: Sequence[str] = ()) -> bool:
        """Whether nothing touches at joint positions (J,)."""
        self._allow(tuple(contact_links))
        return self._inside(q) and not pinocchio.computeCollisions(
            self._kinematics.model, self._data, self._geometry, self._geometry_data, q, True
        )

    def free_count(self, path: Array, *, contact_links: Sequence[str] = ()) -> int:
        """How many configurations of a (K, J) path are free before the first that is not."""
        for k, q in enumerate(path):
            if not self.free(q, contact_links=contact_links):
                return k
        return len(path)

    def edge_free(self, start: Array, end: Array, resolution: float) -> bool:
        """Whether the straight joint motion is free, checked every `resolution` rad, coarse first.

        The ends themselves are not checked.
        """
        count = int(np.ceil(np.abs(end - start).max() / resolution))
        return all(self.free(start + (end - start) * t) for t in _coarse_to_fine(count))

    def _set_scene_margin(self, margin: float) -> None:
        self._scene_margin = margin
        for k in self._scene_pairs:
            self._geometry_data.collisionRequests[k].security_margin = margin

    def _inside(self, q: Array) -> bool:
        if self._workspace is None:
            return True
        tip = self._kinematics.tip(q).position
        return bool((tip >= self._workspace[0]).all() and (tip <= self._workspace[1]).all())

    def _edge(self) -> ContactPair:
        return ContactPair(self._kinematics.tip_frame, WORKSPACE)

    def _allow(self, links: tuple[str, ...]) -> None:
        if links == self._allowed:
            return
        unknown = [name for name in links if name not in self.links]
        if unknown:
            raise ParameterError("unknown links", got=unknown, allowed=self.links)
        for k in self._scene_pairs:
            pair = self._geometry.collisionPairs[k]
            name = _link_name(self._geometry.geometryObjects[pair.first].name)
            presumed = self._geometry.geometryObjects[pair.second].name == HIDDEN
            if name in links or (links and presumed):
                self._geometry_data.deactivateCollisionPair(k)
            else:
                self._geometry_data.activateCollisionPair(k)
        self._allowed = links

    def _rebuild(self) -> None:
        geometry = self._robot.copy()
        pairs = _self_pairs(self._robot)
        margins = [self._margins.self_collision] * len(pairs)
        movable = [i for i, o in enumerate(self._robot.geometryObjects) if o.parentJoint > 0]
        if self._table is not None:
            table = _add(geometry, self._base, self._table)
            # The first link turns in place above the base: it cannot reach the table.
            reaching = [i for i in movable if self._robot.geometryObjects[i].parentJoint > 1]
            pairs += [(i, table) for i in reaching]
            margins += [self._margins.table] * len(reaching)
        first_scene_pair = len(pairs)
        for shape in self._scene_shapes():
            index = geometry.addGeometryObject(shape)
            pairs += [(i, index) for i in movable]
            margins += [self._scene_margin] * len(movable)
        for first, second in pairs:
            geometry.addCollisionPair(pinocchio.CollisionPair(first, second))
        self._geometry = geometry
        self._geometry_data = geometry.createData()
        for request, margin in zip(self._geometry_data.collisionRequests, margins, strict=True):
            request.security_margin = margin
        self._scene_pairs = range(first_scene_pair, len(pairs))
        self._allowed = ()

    def _scene_shapes(self) -> list[pinocchio.GeometryObject]:
        shapes = [_placed(self._base, box) for box in self._boxes]
        for name, cloud in ((CLOUD, self._cloud), (HIDDEN, self._hidden)):
            if cloud is not None:
                tree = coal.makeOctree(cloud.astype(np.float64), self._cell)
                shapes.append(pinocchio.GeometryObject(name, 0, 0, self._base, tree))
        return shapes


def _some(points: object | None, name: str) -> Cloud | None:
    cloud = None if points is None else as_cloud(points, name, min_points=0)
    return cloud if cloud is not None and len(cloud) else None


def _convex_robot(kinematics: Kinematics) -> pinocchio.GeometryModel:
    try:
        robot = pinocchio.buildGeomFromUrdfString(
            kinematics.model, kinematics.urdf, pinocchio.GeometryType.COLLISION
        )
    except ValueError as error:
        raise ParameterError(
            f"cannot load the robot's collision geometry: {error}",
            hint="the description needs absolute mesh paths; description.compose_urdf makes them",
        ) from error
    for shape in robot.geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            shape.geometry.buildConvexHull(True, "Qt")
            shape.geometry = shape.geometry.convex
    return robot


def _self_pairs(robot: pinocchio.GeometryModel) -> list[tuple[int, int]]:
    """Pairs of shapes with at least one joint's body between them."""
    joints = [shape.parentJoint for shape in robot.geometryObjects]
    return [
        (i, j)
        for i in range(len(joints))
        for j in range(i + 1, len(joints))
        if abs(joints[i] - joints[j]) >= 2
    ]


def _table(height: float) -> Box:
    pose = np.eye(4)
    pose[2, 3] = height - _TABLE_SIZE[2] / 2
    return Box(TABLE, _TABLE_SIZE, pose)


def _placed(base: pinocchio.SE3, box: Box) -> pinocchio.GeometryObject:
    placement = base * pinocchio.SE3(box.pose[:3, :3], box.pose[:3, 3])
    return pinocchio.GeometryObject(box.name, 0, 0, placement, coal.Box(*box.size))


def _add(geometry: pinocchio.GeometryModel, base: pinocchio.SE3, box: Box) -> int:
    return int(geometry.addGeometryObject(_placed(base, box)))


def _link_name(shape: str) -> str:
    """`panda_link3_0` is the first shape of `panda_link3`."""
    stem, _, number = shape.rpartition("_")
    return stem if stem and number.isdigit() else shape


def _coarse_to_fine(count: int) -> list[float]:
    """Fractions k / count, 0 < k < count, ordered so that a hit is found early."""
    order: list[float] = []
    seen: set[int] = set()
    stride = count
    while stride > 1:
        stride = (stride + 1) // 2
        for k in range(stride, count, stride):
            if k not in seen:
                seen.add(k)
                order.append(k / count)
    return order
