"""Padded convex solids that stand in for a robot's links: what they contain, what they hide."""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.types import Array, Cloud

_CELLS = 28
"""Cells of the lookup grid along the longest side of a hull."""
_AT_ONCE = 512
"""Points held against all faces at once: as many as stay in the cache."""
_INSIDE, _OUTSIDE, _EITHER = np.uint8(1), np.uint8(0), np.uint8(2)


class Hull:
    """A convex polyhedron, its faces moved outwards by a padding.

    Most points are decided by a lookup: a grid over the hull says inside, outside or either of each
    of its cells, and only points in cells of the last kind are held against every face. The answer
    is that of the faces alone.

    Args:
        corners: (V, 3) whose hull it is.
        padding: [m].

    Raises:
        QhullError, ValueError: the corners span no volume.
    """

    def __init__(self, corners: Array, padding: float) -> None:
        planes = np.unique(np.round(ConvexHull(corners).equations, 6), axis=0)
        planes[:, 3] -= padding
        self.planes = planes.astype(np.float32)
        self.centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
        # Faces moved outwards meet farther out than the padding: where they do, the hull ends.
        self.radius = _reach(planes, corners, self.centre, padding)
        self._grid: NDArray[np.uint8] | None = None
        self._low, self._cell = np.zeros(3, np.float32), np.float32(1.0)

    def contains(self, points: Cloud) -> NDArray[np.bool_]:
        """(N,) for points in the solid's frame."""
        if self._grid is None:
            self._grid = self._make_grid()
        cells = ((points - self._low) / self._cell).astype(np.int32)
        limit = np.array(self._grid.shape, dtype=np.int32) - 1
        # The border cells are outside all around, so points beyond them may be moved there.
        x, y, z = (np.clip(cells[:, axis], 0, limit[axis]) for axis in range(3))
        verdict = self._grid[x, y, z]
        result = verdict == _INSIDE
        unsure = np.flatnonzero(verdict == _EITHER)
        result[unsure] = self._within_faces(points[unsure])
        return np.asarray(result)

    def distance(self, points: Cloud) -> NDArray[np.float32]:
        """(N,) signed distance of points in the solid's frame to the farthest face's plane [m].

        That is the distance to the surface inside and in front of a face, and less beyond an edge.
        """
        result = np.empty(len(points), np.float32)
        normals, offsets = self.planes[:, :3], self.planes[:, 3:]
        for begin in range(0, len(points), _AT_ONCE):
            values = normals @ points[begin : begin + _AT_ONCE].T
            values += offsets
            np.max(values, axis=0, out=result[begin : begin + _AT_ONCE])
        return result

    def hides(self, eye: Array, points: Cloud) -> NDArray[np.bool_]:
        """(N,) whether the solid cuts the line from `eye` to each point; both in its frame."""
        normals, offsets = self.planes[:, :3], self.planes[:, 3]
        at_eye = normals @ eye.astype(np.float32) + offsets
        along = (points - eye.astype(np.float32)) @ normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            cut = -at_eye / along
        enter = np.max(np.where(along < 0, cut, -np.inf), axis=1)
        leave = np.min(np.where(along > 0, cut, np.inf), axis=1)
        beside = ((along == 0) & (at_eye > 0)).any(axis=1)
        return np.asarray(~beside & (np.maximum(enter, 0) < np.minimum(leave, 1)))

    def _within_faces(self, points: Cloud) -> NDArray[np.bool_]:
        return np.asarray(
            (points @ self.planes[:, :3].T + self.planes[:, 3] <= 0).all(axis=1), dtype=bool
        )

    def _make_grid(self) -> NDArray[np.uint8]:
        # The padded corners lie within the bounding sphere, but the box of the faces is tighter.
        reach = np.float32(self.radius)
        cell = 2 * reach / _CELLS
        low = self.centre.astype(np.float32) - reach - cell
        steps = (np.arange(_CELLS + 2, dtype=np.float32) + np.float32(0.5)) * cell
        centres = np.stack(np.meshgrid(*(low[a] + steps for a in range(3)), indexing="ij"), -1)
        flat = centres.reshape(-1, 3)
        worst = np.concatenate(
            [
                (part @ self.planes[:, :3].T + self.planes[:, 3]).max(axis=1)
                for part in np.array_split(flat, 16)
            ]
        )
        # No plane's value changes by more than this between a cell's centre and its corners.
        slack = np.float32(0.87) * cell + np.float32(1e-6)
        verdict = np.where(worst <= -slack, _INSIDE, np.where(worst > slack, _OUTSIDE, _EITHER))
        self._low, self._cell = low, cell
        return verdict.astype(np.uint8).reshape(centres.shape[:3])


@dataclass(frozen=True)
class Round:
    """A cylinder along z, or a sphere.

    Attributes:
        r: Radius, padding included [m].
        half: Half length of the cylinder, padding included [m]; None for a sphere.
    """

    r: float
    half: float | None = None

    @property
    def centre(self) -> Array:
        """(3,) middle of the bounding sphere."""
        return np.zeros(3)

    @property
    def radius(self) -> float:
        """Radius of the bounding sphere [m]."""
        return self.r if self.half is None else float(np.hypot(self.r, self.half))

    def contains(self, points: Cloud) -> NDArray[np.bool_]:
        """(N,) for points in the solid's frame."""
        square = points[:, 0] ** 2 + points[:, 1] ** 2
        if self.half is None:
            return np.asarray(square + points[:, 2] ** 2 <= np.float32(self.r**2))
        return np.asarray(
            (square <= np.float32(self.r**2)) & (np.abs(points[:, 2]) <= np.float32(self.half))
        )

    def distance(self, points: Cloud) -> NDArray[np.float32]:
        """(N,) signed distance of points in the solid's frame to its surface [m]."""
        if self.half is None:
            return np.asarray(np.linalg.norm(points, axis=1) - np.float32(self.r))
        aside = np.hypot(points[:, 0], points[:, 1]) - np.float32(self.r)
        above = np.abs(points[:, 2]) - np.float32(self.half)
        outside = np.hypot(np.maximum(aside, 0), np.maximum(above, 0))
        return np.asarray(outside + np.minimum(np.maximum(aside, above), 0))

    def hides(self, eye: Array, points: Cloud) -> NDArray[np.bool_]:
        """(N,) whether the solid cuts the line from `eye` to each point; both in its frame."""
        step = points.astype(float) - eye
        axes = slice(0, 3) if self.half is None else slice(0, 2)
        a = np.sum(step[:, axes] ** 2, axis=1)
        b = step[:, axes] @ eye[axes]
        c = float(eye[axes] @ eye[axes]) - self.r**2
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(b * b - a * c)
            enter, leave = (-b - root) / a, (-b + root) / a
        enter, leave = np.nan_to_num(enter, nan=np.inf), np.nan_to_num(leave, nan=-np.inf)
        if self.half is not None:
            along_axis = a == 0
            enter[along_axis], leave[along_axis] = (-np.inf, np.inf) if c <= 0 else (np.inf, 0)
            with np.errstate(divide="ignore", invalid="ignore"):
                low, high = (-self.half - eye[2]) / step[:, 2], (self.half - eye[2]) / step[:, 2]
            level = step[:, 2] == 0
            within = abs(eye[2]) <= self.half
            low[level], high[level] = (-np.inf, np.inf) if within else (np.inf, np.inf)
            enter = np.maximum(enter, np.minimum(low, high))
            leave = np.minimum(leave, np.maximum(low, high))
        return np.asarray(np.maximum(enter, 0) < np.minimum(leave, 1))


def solid_of(
    item: pinocchio.GeometryObject, link: str, scale: float, padding: float
) -> Hull | Round:
    """The padded solid of one collision shape; meshes count as their convex hulls.

    Args:
        item: The shape.
        link: Whose it is, for messages.
        scale: Of the shape about its middle, before padding.
        padding: Added all around [m].

    Raises:
        ObjectModelError: a kind of shape that cannot be used, or a mesh without volume.
    """
    shape = item.geometry
    if isinstance(shape, coal.Cylinder | coal.Capsule):
        extra = shape.radius if isinstance(shape, coal.Capsule) else 0.0
        return Round(scale * shape.radius + padding, scale * (shape.halfLength + extra) + padding)
    if isinstance(shape, coal.Sphere):
        return Round(scale * shape.radius + padding)
    if isinstance(shape, coal.Box):
        corners = np.array(np.meshgrid(*[(-h, h) for h in shape.halfSide])).reshape(3, -1).T
    elif hasattr(shape, "vertices"):
        corners = np.asarray(shape.vertices()) * np.asarray(item.meshScale)
    else:
        raise ObjectModelError(
            f"link {link} has a shape the robot filter cannot use",
            got=type(shape).__name__,
            allowed="mesh, box, cylinder, capsule, sphere",
        )
    try:
        middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
        return Hull(middle + scale * (corners - middle), padding)
    except (QhullError, ValueError) as error:
        raise ObjectModelError(f"link {link} has a flat or empty mesh: {error}") from error


def _reach(planes: Array, corners: Array, centre: Array, padding: float) -> float:
    """Radius about `centre` that holds the padded hull."""
    distance = -(planes[:, :3] @ centre + planes[:, 3])
    inner = float(np.min(distance)) - padding
    outer = float(np.max(np.linalg.norm(corners - centre, axis=1)))
    # Scaling the hull about its centre by (inner + padding) / inner contains the padded hull.
    return outer * (inner + padding) / inner if inner > 1e-4 else 2 * (outer + padding)
