"""Which points lie on the robot: containment in its padded links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from flowbothd_common.errors import ObjectModelError, ParameterError
from flowbothd_common.transforms import inverse
from flowbothd_common.types import Array, Cloud
from flowbothd_perception.params import RobotFilterParams


@dataclass(frozen=True)
class _Solid:
    """One padded convex shape of a link.

    Attributes:
        link: Name of the link.
        frame: Index of the shape among the model's geometry objects.
        centre: (3,) of the bounding sphere, in the shape's frame.
        radius: Of the bounding sphere, padding included.
        planes: (F, 4) n.x + d <= 0 inside, padding included; empty for a cylinder or sphere.
        round: (radius, half length) of a cylinder along z, padding included; half length < 0 for
            a sphere.
    """

    link: str
    frame: int
    centre: Array
    radius: float
    planes: NDArray[np.float32]
    round: tuple[float, float] | None = None

    def contains(self, points: Cloud) -> NDArray[np.bool_]:
        """(N,) for points in the shape's frame."""
        if self.round is None:
            distances = points @ self.planes[:, :3].T + self.planes[:, 3]
            return np.asarray((distances <= 0).all(axis=1))
        radius, half = self.round
        square = np.einsum("ij,ij->i", points[:, :2], points[:, :2])
        if half < 0:
            return np.asarray(square + points[:, 2] ** 2 <= radius**2)
        return np.asarray((square <= radius**2) & (np.abs(points[:, 2]) <= half))


class RobotFilter:
    """Tells the robot's points from others, given the joint positions.

    Meshes count as their convex hulls, which is what collision meshes of arms are; padding moves
    every face outwards. Growing the padding can only add points.

    Args:
        urdf: Text of the robot description, mesh paths absolute.
        params: Paddings and links to leave out.

    Raises:
        ObjectModelError: the description cannot be read, or a link has no usable shape.
        ParameterError: a padded or ignored link does not exist.
    """

    def __init__(self, urdf: str, params: RobotFilterParams) -> None:
        try:
            self._model = pinocchio.buildModelFromXML(urdf)
            self._geometry = pinocchio.buildGeomFromUrdfString(
                self._model, urdf, pinocchio.GeometryType.COLLISION
            )
        except (RuntimeError, ValueError) as error:
            raise ObjectModelError(
                f"robot description cannot be read: {error}",
                hint="it must be a URDF with absolute mesh paths, as motion_node publishes it",
            ) from error
        self._data = self._model.createData()
        self._geometry_data = self._geometry.createData()
        links = [frame.name for frame in self._model.frames]
        unknown = sorted({*params.padded_links, *params.ignored_links} - set(links))
        if unknown:
            raise ParameterError(
                "robot filter parameters name unknown links", got=unknown, allowed=", ".join(links)
            )
        paddings = dict(zip(params.padded_links, params.paddings, strict=True))
        self._solids: list[_Solid] = []
        for index, item in enumerate(self._geometry.geometryObjects):
            link = self._model.frames[item.parentFrame].name
            if link not in params.ignored_links:
                self._solids.append(_solid(link, index, item, paddings.get(link, params.padding)))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints whose positions are needed, in order."""
        return tuple(self._model.names[1:])

    def on_robot(
        self, points: Cloud, joint_positions: Sequence[float] | Array
    ) -> NDArray[np.bool_]:
        """(N,) whether each point (in base) lies within the padded robot.

        Raises:
            ParameterError: another number of joint positions than `joint_names`.
        """
        positions = np.asarray(joint_positions, dtype=float)
        if positions.shape != (self._model.nq,):
            raise ParameterError(
                "number of joint positions",
                got=positions.shape,
                allowed=f"one for each of {', '.join(self.joint_names)}",
            )
        pinocchio.forwardKinematics(self._model, self._data, positions)
        pinocchio.updateGeometryPlacements(
            self._model, self._data, self._geometry, self._geometry_data
        )
        result = np.zeros(len(points), dtype=bool)
        columns = np.ascontiguousarray(points.T)
        for solid in self._solids:
            placement = self._geometry_data.oMg[solid.frame].homogeneous
            near = _near(columns, placement[:3, :3] @ solid.centre + placement[:3, 3], solid.radius)
            if not len(near):
                continue
            local = inverse(placement).astype(np.float32)
            inside = solid.contains(points[near] @ local[:3, :3].T + local[:3, 3])
            result[near[inside]] = True
        return result


def _near(columns: Cloud, centre: Array, radius: float) -> NDArray[np.intp]:
    """Indices of (3, N) points within a sphere."""
    x, y, z = (columns[axis] - np.float32(centre[axis]) for axis in range(3))
    return np.flatnonzero(x * x + y * y + z * z <= np.float32(radius) ** 2)


def _solid(link: str, index: int, item: pinocchio.GeometryObject, padding: float) -> _Solid:
    shape, nothing = item.geometry, np.empty((0, 4), np.float32)
    if isinstance(shape, coal.Cylinder | coal.Capsule):
        extra = shape.radius if isinstance(shape, coal.Capsule) else 0.0
        size = (shape.radius + padding, shape.halfLength + extra + padding)
        return _Solid(link, index, np.zeros(3), float(np.hypot(*size)), nothing, size)
    if isinstance(shape, coal.Sphere):
        size = (shape.radius + padding, -1.0)
        return _Solid(link, index, np.zeros(3), size[0], nothing, size)
    if isinstance(shape, coal.Box):
        half = np.asarray(shape.halfSide)
        corners = np.array(np.meshgrid(*[(-h, h) for h in half])).reshape(3, -1).T
    elif hasattr(shape, "vertices"):
        corners = np.asarray(shape.vertices()) * np.asarray(item.meshScale)
    else:
        raise ObjectModelError(
            f"link {link} has a shape the robot filter cannot use",
            got=type(shape).__name__,
            allowed="mesh, box, cylinder, capsule, sphere",
        )
    try:
        planes = np.unique(np.round(ConvexHull(corners).equations, 6), axis=0)
    except (QhullError, ValueError) as error:
        raise ObjectModelError(f"link {link} has a flat or empty mesh: {error}") from error
    planes[:, 3] -= padding
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    # Faces moved outwards meet farther out than the padding: where they do, the hull ends.
    radius = _reach(planes, corners, centre, padding)
    return _Solid(link, index, centre, radius, planes.astype(np.float32))


def _reach(planes: Array, corners: Array, centre: Array, padding: float) -> float:
    """Radius about `centre` that holds the padded hull."""
    distance = -(planes[:, :3] @ centre + planes[:, 3])
    inner = float(np.min(distance)) - padding
    outer = float(np.max(np.linalg.norm(corners - centre, axis=1)))
    # Scaling the hull about its centre by (inner + padding) / inner contains the padded hull.
    return outer * (inner + padding) / inner if inner > 1e-4 else 2 * (outer + padding)
