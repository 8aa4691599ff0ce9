"""Which points lie on the robot, or where only its shadow can be."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio
from numpy.typing import NDArray

from flowbothd_common.errors import ObjectModelError, ParameterError
from flowbothd_common.transforms import inverse
from flowbothd_common.types import Array, Cloud
from flowbothd_perception.params import RobotFilterParams
from flowbothd_perception.solids import Hull, Round, solid_of


@dataclass(frozen=True)
class _Part:
    """One solid of a link.

    Attributes:
        link: Name of the link.
        frame: Index of the shape among the model's geometry objects.
        solid: Padded.
        shadow: Solids that cast the shadow, with their own padding; None without shadows.
    """

    link: str
    frame: int
    solid: Hull | Round
    shadow: Hull | Round | None


class RobotFilter:
    """Tells the robot's points from others, given the joint positions.

    Growing padding or scale can only add points.

    Args:
        urdf: Text of the robot description. Mesh paths are absolute, or package:// paths of
            packages under AMENT_PREFIX_PATH.
        params: Scale, paddings, shadows, and links to leave out.

    Raises:
        ObjectModelError: the description cannot be read, or a link has no usable shape.
        ParameterError: a padded or ignored link does not exist.
    """

    def __init__(self, urdf: str, params: RobotFilterParams) -> None:
        self._model, self._geometry = _read(urdf)
        self._data = self._model.createData()
        self._geometry_data = self._geometry.createData()
        links = [frame.name for frame in self._model.frames]
        unknown = sorted({*params.padded_links, *params.ignored_links} - set(links))
        if unknown:
            raise ParameterError(
                "robot filter parameters name unknown links", got=unknown, allowed=", ".join(links)
            )
        self._parts = [
            self._part(index, item, params)
            for index, item in enumerate(self._geometry.geometryObjects)
            if self._link_of(item) not in params.ignored_links
        ]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints whose positions are needed, in order."""
        return tuple(self._model.names[1:])

    @property
    def links(self) -> tuple[str, ...]:
        """Links that have a shape and are not ignored, one for each of its shapes."""
        return tuple(part.link for part in self._parts)

    def on_robot(
        self, points: Cloud, joint_positions: Sequence[float] | Array, eye: Array | None = None
    ) -> NDArray[np.bool_]:
        """(N,) whether each point (in base) lies within the padded robot.

        Args:
            points: (N, 3) in base.
            joint_positions: (J,) in the order of `joint_names`.
            eye: (3,) of the camera in base. If shadows are wanted, points that the robot hides
                from there count too: what is measured there is a ray that touched the robot's edge.

        Raises:
            ParameterError: another number of joint positions than `joint_names`.
        """
        self._place(joint_positions)
        result = np.zeros(len(points), dtype=bool)
        columns = np.ascontiguousarray(points.T)
        for part in self._parts:
            placement = self._geometry_data.oMg[part.frame].homogeneous
            centre = placement[:3, :3] @ part.solid.centre + placement[:3, 3]
            near = _near(columns, centre, part.solid.radius)
            local = inverse(placement).astype(np.float32)
            if len(near):
                inside = part.solid.contains(points[near] @ local[:3, :3].T + local[:3, 3])
                result[near[inside]] = True
            if part.shadow is None or eye is None:
                continue
            behind = _in_cone(columns, eye, centre, part.shadow.radius)
            if len(behind):
                seen_from = inverse(placement)[:3, :3] @ eye + inverse(placement)[:3, 3]
                there = points[behind] @ local[:3, :3].T + local[:3, 3]
                result[behind[part.shadow.hides(seen_from, there)]] = True
        return result

    def distances(
        self,
        points: Cloud,
        joint_positions: Sequence[float] | Array,
        links: frozenset[str] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        """Signed distance of each point (in base) to the padded robot [m], and its nearest part.

        Args:
            points: (N, 3) in base.
            joint_positions: (J,) in the order of `joint_names`.
            links: Only these count; None = all.

        Returns:
            (N,) distances, negative inside; (N,) indices into `links`.

        Raises:
            ParameterError: another number of joint positions than `joint_names`.
        """
        self._place(joint_positions)
        best = np.full(len(points), np.inf, dtype=np.float32)
        nearest = np.zeros(len(points), dtype=np.intp)
        for index, part in enumerate(self._parts):
            if links is not None and part.link not in links:
                continue
            local = inverse(self._geometry_data.oMg[part.frame].homogeneous).astype(np.float32)
            distance = part.solid.distance(points @ local[:3, :3].T + local[:3, 3])
            closer = distance < best
            best[closer], nearest[closer] = distance[closer], index
        return best, nearest

    def _part(self, index: int, item: pinocchio.GeometryObject, params: RobotFilterParams) -> _Part:
        link = self._link_of(item)
        padding, scale = params.padding, params.scale
        if link in params.padded_links:
            at = params.padded_links.index(link)
            padding = params.paddings[at]
            scale = params.scales[at] if params.scales else scale
        shadow = None
        if params.shadow:
            shadow = solid_of(item, link, scale, min(padding, params.shadow_padding))
        return _Part(link, index, solid_of(item, link, scale, padding), shadow)

    def _link_of(self, item: pinocchio.GeometryObject) -> str:
        return str(self._model.frames[item.parentFrame].name)

    def _place(self, joint_positions: Sequence[float] | Array) -> None:
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


def _read(urdf: str) -> tuple[pinocchio.Model, pinocchio.GeometryModel]:
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    shares = [str(Path(prefix) / "share") for prefix in prefixes if prefix]
    try:
        model = pinocchio.buildModelFromXML(urdf)
        geometry = pinocchio.buildGeomFromUrdfString(
            model, urdf, pinocchio.GeometryType.COLLISION, package_dirs=shares
        )
    except (RuntimeError, ValueError) as error:
        raise ObjectModelError(
            f"robot description cannot be read: {error}",
            hint="it must be a URDF with absolute mesh paths, as motion_node publishes it",
        ) from error
    return model, geometry


def _near(columns: Cloud, centre: Array, radius: float) -> NDArray[np.intp]:
    """Indices of (3, N) points within a sphere."""
    x, y, z = (columns[axis] - np.float32(centre[axis]) for axis in range(3))
    return np.flatnonzero(x * x + y * y + z * z <= np.float32(radius) ** 2)


def _in_cone(columns: Cloud, eye: Array, centre: Array, radius: float) -> NDArray[np.intp]:
    """Indices of (3, N) points whose line from `eye` passes through a sphere."""
    to_centre = centre - eye
    x, y, z = (columns[axis] - np.float32(eye[axis]) for axis in range(3))
    along = (
        x * np.float32(to_centre[0]) + y * np.float32(to_centre[1]) + z * np.float32(to_centre[2])
    )
    # |v x c|^2 <= r^2 |v|^2, and in front of the eye; within the sphere all directions count.
    square = x * x + y * y + z * z
    distance = np.float32(to_centre @ to_centre)
    aside = square * distance - along * along <= np.float32(radius) ** 2 * square
    return np.flatnonzero(aside & ((along > 0) | (distance <= np.float32(radius) ** 2)))
