"""Grasp point and direction of pull, from one flow field.

The paper grasps at the point with the largest flow norm. That point lies on the very edge of the
part, where a cup cannot seal, and of many points with nearly the same norm noise picks one. With
``edge_margin`` > 0 the choice is made among points whose norm is within the leverage threshold
of the largest, for a place that is flat, faces the pull, and is surrounded by the part on all
sides; if none of them would seal, among points with less leverage. With 0 it is the paper's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.transforms import angle_between, rotation_between, unit
from flowbothd_common.types import Array, Cloud
from flowbothd_policy.params import GraspParams
from flowbothd_policy.screw import Screw, fit_screw

_DIRECTIONS = 16
"""Directions in which the distance to the edge of the part is measured."""
_MAX_CANDIDATES = 64
"""Points at most whose distance to the edge is measured, which is the costly part."""
_STILL = 1e-6
"""Flow norm below which nothing moves [-]; flows are max-normalised."""


@dataclass(frozen=True)
class Place:
    """A place to keep off: pulls within an angle of `direction` from within `radius` of it.

    Attributes:
        point: (3,) [m].
        direction: (3,) unit.
        radius: [m].
    """

    point: Array
    direction: Array
    radius: float


@dataclass(frozen=True)
class Grasp:
    """A place for the cup and the pull from there.

    Attributes:
        index: Row of the cloud.
        point: (3,) in base [m].
        flow: (3,) max-normalised flow to act upon.
        norm: Norm of the predicted flow at the point.
        largest: Largest norm of the field.
        screw: Fitted rigid motion of the part, if it fits well enough to be trusted.
        edge_distance: Estimated distance of the point from the edge of the part [m]; nan if
            that was not asked for.
    """

    index: int
    point: Array
    flow: Array
    norm: float
    largest: float
    screw: Screw | None
    edge_distance: float = float("nan")

    @property
    def direction(self) -> Array:
        """(3,) unit vector of the flow to act upon."""
        return unit(self.flow)


def select_grasp(
    points: Cloud,
    flow: NDArray[np.float32],
    params: GraspParams,
    *,
    leverage: float,
    avoid: Sequence[Place] = (),
    avoid_angle: float = 0.0,
) -> Grasp | None:
    """Choose the grasp of one flow field.

    Args:
        points: (N, 3) in base [m].
        flow: (N, 3) max-normalised.
        params: How to choose.
        leverage: Loss of norm that a better place may cost.
        avoid: Places to keep off.
        avoid_angle: Pulls within this angle [rad] of a place's direction are kept off it.

    Returns:
        The grasp, or None if nothing moves or every place that would do is to be avoided.
    """
    norms = np.linalg.norm(flow, axis=1)
    top = int(np.argmax(norms))
    largest = float(norms[top])
    if largest < _STILL:
        return None
    screw = _trusted(fit_screw(points, flow, points[top].astype(float)), params)
    leverages = _leverages(points, flow, norms, screw, params)
    index, distance = -1, -np.inf
    for loss in (leverage, max(leverage, params.fallback_loss)):
        band = np.flatnonzero(leverages >= float(leverages.max()) * (1 - loss))
        allowed = _without_avoided(points, flow, band, avoid, avoid_angle)
        if not len(allowed):
            continue
        allowed = _clear_of_table(points, flow, allowed, params.table_clearance)
        if params.edge_margin <= 0:
            index, distance = int(allowed[np.argmax(leverages[allowed])]), float("nan")
            break
        found, reach = _most_surrounded(points, flow, leverages, allowed, params)
        if reach > distance:
            index, distance = found, reach
        if distance >= params.edge_margin:
            break
    if index < 0:
        return None
    own = flow[index].astype(float)
    point = points[index].astype(float)
    if params.direction == "screw" and screw is not None:
        smooth = screw.flow_at(point)
        if np.linalg.norm(smooth) > _STILL and angle_between(smooth, own) < np.pi / 2:
            own = smooth
    normal = _flat_normal(points, norms, index, params) if params.normal_angle > 0 else None
    if normal is not None:
        normal = normal * np.copysign(1.0, normal @ own)
        if params.normal_tolerance < angle_between(normal, own) <= params.normal_angle:
            turn = rotation_between(own, normal)
            own = turn @ own
            screw = screw.turned(turn, point) if screw is not None else None
    return Grasp(index, point, own, float(norms[index]), largest, screw, distance)


def _trusted(screw: Screw | None, params: GraspParams) -> Screw | None:
    return screw if screw is not None and screw.residual <= params.screw_residual else None


def _without_avoided(
    points: Cloud,
    flow: NDArray[np.float32],
    band: NDArray[np.intp],
    avoid: Sequence[Place],
    angle: float,
) -> NDArray[np.intp]:
    keep = np.ones(len(band), dtype=bool)
    unit_flow = flow[band] / np.linalg.norm(flow[band], axis=1, keepdims=True)
    for place in avoid:
        near = np.linalg.norm(points[band] - place.point, axis=1) < place.radius
        keep &= ~(near & (unit_flow @ place.direction > np.cos(angle)))
    return band[keep]


def _clear_of_table(
    points: Cloud, flow: NDArray[np.float32], candidates: NDArray[np.intp], clearance: float
) -> NDArray[np.intp]:
    """Those of the candidates below which the wrist has room; all of them if there are none.

    The wrist lies behind the cup, against the pull: at the height of the cup for a horizontal pull,
    above it for a lid.
    """
    pulls = flow[candidates] / np.linalg.norm(flow[candidates], axis=1, keepdims=True)
    needed = clearance * np.sqrt(np.clip(1 - pulls[:, 2] ** 2, 0, 1))
    clear = candidates[points[candidates, 2] >= needed]
    return clear if len(clear) else candidates


def _leverages(
    points: Cloud,
    flow: NDArray[np.float32],
    norms: NDArray[np.float32],
    screw: Screw | None,
    params: GraspParams,
) -> NDArray[np.float64]:
    """(N,) what each point is worth as a grasp: its norm, or what the fitted motion gives it.

    The largest of many noisy norms is well above the true one, so a band below it would hold
    hardly any point; the fitted motion ranks places without the noise. Points that do not move
    as it says belong to something else and are worth nothing. The paper's arg max takes the
    norms as they are.
    """
    if screw is None or params.edge_margin <= 0:
        return norms.astype(float)
    fitted = screw.flow_at(points.astype(float))
    sizes = np.linalg.norm(fitted, axis=1)
    belongs = np.linalg.norm(flow - fitted, axis=1) < 0.5 * sizes
    return np.where(belongs, sizes, 0.0) if belongs.any() else norms.astype(float)


def _most_surrounded(
    points: Cloud,
    flow: NDArray[np.float32],
    leverages: NDArray[np.float64],
    candidates: NDArray[np.intp],
    params: GraspParams,
) -> tuple[int, float]:
    """The candidate to hold and its distance from the edge.

    Among candidates that lie far enough from the edge the largest leverage wins; if there is
    none, the one farthest from it.
    """
    cloud = points[leverages > 0.2 * float(leverages.max())].astype(float)
    spacing = _spacing(cloud)
    order = candidates[np.argsort(-leverages[candidates], kind="stable")]
    best, best_distance = int(order[0]), -np.inf
    for index in order[:: 1 + (len(order) - 1) // _MAX_CANDIDATES]:
        distance = _edge_distance(points[index].astype(float), flow[index], cloud, spacing, params)
        if distance > best_distance:
            best, best_distance = int(index), distance
        if distance >= params.edge_margin:
            break
    return best, best_distance


def _flat_normal(
    points: Cloud, norms: NDArray[np.float32], index: int, params: GraspParams
) -> Array | None:
    """(3,) unit normal of the moving surface around a point, either sign; None if not flat."""
    cloud = points[norms > 0.2 * float(norms.max())].astype(float)
    radius = max(2.5 * params.edge_margin, 4 * _spacing(cloud))
    point = points[index].astype(float)
    fitted = _plane(cloud[np.linalg.norm(cloud - point, axis=1) < radius], point)
    return fitted[0] if fitted is not None and fitted[1] <= 2 * params.flatness else None


def _plane(around: Array, point: Array) -> tuple[Array, float] | None:
    """Normal of (K, 3) points, and how far nine in ten keep to the plane through `point` [m]."""
    if len(around) < 5:
        return None
    centred = around - around.mean(axis=0)
    normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
    off = np.sort(np.abs((around - point) @ normal))
    return normal, float(off[int(0.9 * (len(off) - 1))])


def _spacing(cloud: Array) -> float:
    """Typical distance between neighbouring points [m]."""
    probe = cloud[:: max(1, len(cloud) // 64)]
    if len(cloud) < 2:
        return 0.0
    square = np.sum((probe[:, None] - cloud[None]) ** 2, axis=2)
    return float(np.sqrt(np.median(np.partition(square, 1, axis=1)[:, 1])))


def _edge_distance(
    point: Array, flow: NDArray[np.float32], cloud: Array, spacing: float, params: GraspParams
) -> float:
    """Estimate how far the flat surface around a point reaches in its narrowest direction [m].

    Looks along strips in 16 tangent directions and takes the farthest point of the part that is
    reached without a gap. A cloud locates an edge no better than its spacing, so sparse clouds keep
    farther from it. Negative where the place is not flat or does not face the pull.
    """
    reach = max(3 * params.edge_margin, 6 * spacing)
    near = cloud[np.linalg.norm(cloud - point, axis=1) < reach]
    around = near[np.linalg.norm(near - point, axis=1) < max(params.edge_margin, 3 * spacing)]
    fitted = _plane(around, point)
    if fitted is None:
        return -1.0
    normal, roughness = fitted
    if roughness > params.flatness:
        return -0.5
    facing = float(np.abs(normal @ unit(flow)))
    if facing < np.cos(max(params.max_tilt, params.normal_angle)):
        return -1.0 + facing * 0.1
    flat = near[np.abs((near - point) @ normal) <= 2 * params.flatness] - point
    first = unit(np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))]))
    plane = np.column_stack([flat @ first, flat @ np.cross(normal, first)])
    half_width = max(0.5 * params.edge_margin, spacing)
    gap = 3 * half_width
    angles = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    ahead = plane @ np.stack([np.cos(angles), np.sin(angles)])
    across = np.abs(plane @ np.stack([-np.sin(angles), np.cos(angles)]))
    return min(
        _unbroken(np.sort(ahead[(across[:, k] < half_width) & (ahead[:, k] >= 0), k]), gap)
        for k in range(_DIRECTIONS)
    )


def _unbroken(along: Array, gap: float) -> float:
    """Return the extent of sorted distances before the first gap."""
    reached = 0.0
    for value in along:
        if value - reached > gap:
            break
        reached = float(value)
    return reached
