"""Visible points of an object, with the ground-truth flow of every point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from flowbothd_common.types import Array, Cloud
from flowbothd_model.data.arm_shadow import hidden_by_arm
from flowbothd_model.data.articulated import (
    ArticulatedObject,
    Ints,
    axis_rotation,
    flow_of,
    max_normalised,
)
from flowbothd_model.data.camera import View
from flowbothd_model.data.raycast import PixelGrid, cast_rays

_EDGE = 0.02  # relative depth step that counts as an edge
_RAYS = 96  # side of the grid of rays laid over the object
_FINE = 2.5  # refinement where the object covers too few rays


@dataclass(frozen=True)
class Observation:
    """A cloud with its truth.

    Attributes:
        points: (N, 3) float32, object frame [m].
        flow: (N, 3) float32, max-normalised over the visible points.
        link: (N,) int64, the link each point belongs to.
    """

    points: Cloud
    flow: Cloud
    link: Ints


def observe(
    item: ArticulatedObject,
    positions: Array,
    view: View,
    points: int,
    rng: np.random.Generator,
    device: torch.device | str = "cpu",
) -> Observation | None:
    """Cast rays from `view` at the object with its joints at `positions`, keep `points` hits.

    None if the object covers too few pixels, or if nothing of what is visible moves.
    """
    vertices = torch.from_numpy(item.posed_vertices(positions)).to(device)
    transform = torch.from_numpy(view.T_camera_object.astype(np.float32)).to(device)
    in_camera = vertices @ transform[:3, :3].T + transform[:3, 3]
    faces = torch.from_numpy(item.faces).to(device)
    for rays in (_RAYS, int(_RAYS * _FINE)):
        grid = _grid_over(in_camera, view, rays, rng)
        if grid is None:
            return None
        depth, face = cast_rays(in_camera, faces, grid)
        if int((face >= 0).sum()) >= points * (1.15 + 0.45 * bool(view.cut) + 0.6 * bool(view.arm)):
            break
    else:
        return None
    seen, link = _measured(depth, face, item, view, grid, rng)
    rotation, shift = view.T_camera_object[:3, :3], view.T_camera_object[:3, 3]
    cloud = ((seen - shift) @ rotation).astype(np.float32)
    above = np.flatnonzero(cloud[:, 2] > view.floor)
    if len(above) < points:
        return None
    pick = rng.permutation(above)[:points]
    cloud, link = cloud[pick], link[pick]
    flow = flow_of(item.opening_twists(positions), link, cloud)
    if np.linalg.norm(flow, axis=1).max() < 1e-6:
        return None
    return Observation(cloud, max_normalised(flow), link)


def _grid_over(
    in_camera: Tensor, view: View, rays: int, rng: np.random.Generator
) -> PixelGrid | None:
    """A grid of about `rays` squared square pixels over the object, as far as it is in view."""
    ahead = in_camera[in_camera[:, 2] > 0.05]
    if len(ahead) == 0:
        return None
    pixels = (ahead[:, :2] / ahead[:, 2:] * view.focal).cpu().numpy()
    half = np.array([view.width / 2, view.height / 2])
    low, high = np.maximum(pixels.min(0), -half), np.minimum(pixels.max(0), half)
    extent = high - low
    if extent.min() < 1.0:
        return None
    step = float(np.sqrt(extent[0] * extent[1])) / rays
    size = np.ceil(extent / step).astype(int)
    offset = -low / step + rng.uniform(-0.5, 0.5, 2)
    focal = view.focal / step
    return PixelGrid(int(size[0]), int(size[1]), focal, focal, float(offset[0]), float(offset[1]))


def _measured(
    depth: Tensor,
    face: Tensor,
    item: ArticulatedObject,
    view: View,
    grid: PixelGrid,
    rng: np.random.Generator,
) -> tuple[Array, Ints]:
    """Hits in the camera frame with the camera's errors: (M, 3) points and (M,) links."""
    z_image, faces = depth.cpu().numpy().astype(np.float64), face.cpu().numpy()
    row, column = np.nonzero(faces >= 0)
    z = z_image[row, column]
    if view.flying:
        z = _fly(z_image, row, column, z, view.flying, rng)
    if view.depth_noise:
        z = z + rng.normal(size=len(z)) * view.depth_noise * z**2
    x = (column + 0.5 - grid.cx) / grid.fx * z
    y = (row + 0.5 - grid.cy) / grid.fy * z
    seen = np.stack((x, y, z), axis=1)
    link = item.vertex_link[item.faces[faces[row, column], 0]]
    if view.arm and len(seen):
        shown = ~hidden_by_arm(seen, link, view.arm, rng)
        seen, link = seen[shown], link[shown]
    if view.cut:
        angle = rng.uniform(0, 2 * np.pi)
        along = seen[:, :2] @ np.array([np.cos(angle), np.sin(angle)])
        kept = along > np.quantile(along, view.cut)
        seen, link = seen[kept], link[kept]
    return seen, link


def _fly(
    z_image: Array,
    row: Ints,
    column: Ints,
    z: Array,
    share: float,
    rng: np.random.Generator,
) -> Array:
    """Move a `share` of the pixels at depth edges towards the depth of a neighbour."""
    shift = rng.integers(-1, 2, size=(2, len(z)))
    other = z_image[
        np.clip(row + shift[0], 0, z_image.shape[0] - 1),
        np.clip(column + shift[1], 0, z_image.shape[1] - 1),
    ]
    edge = np.isfinite(other) & (np.abs(other - z) > _EDGE * z) & (rng.random(len(z)) < share)
    mixed = z + rng.random(len(z)) * (np.where(np.isfinite(other), other, z) - z)
    return np.where(edge, mixed, z)


def turned(observation: Observation, yaw: float, mirror: bool) -> Observation:
    """The observation turned about z by `yaw` [rad], after a reflection of y if `mirror`."""
    matrix = axis_rotation(np.array([0.0, 0.0, 1.0]), yaw)
    if mirror:
        matrix = matrix @ np.diag([1.0, -1.0, 1.0])
    turn = matrix.T.astype(np.float32)
    return Observation(observation.points @ turn, observation.flow @ turn, observation.link)
