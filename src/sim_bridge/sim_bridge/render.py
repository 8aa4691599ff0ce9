"""Shaded pictures of a world for reports: sunlight with shadows, coloured parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike, NDArray

from flowbothd_common.transforms import look_at, unit
from flowbothd_common.types import Array
from sim_bridge.camera import Intrinsics
from sim_bridge.mesh import GREY
from sim_bridge.scene import Part, tensor

_LIGHT = unit((-0.35, -0.45, 0.9))
_SKY = np.array([0.97, 0.98, 1.0])
_HORIZON = np.array([0.86, 0.88, 0.91])


def render_rgb(
    parts: Sequence[Part],
    poses: Mapping[str, Array],
    eye: ArrayLike,
    target: ArrayLike,
    size: tuple[int, int] = (640, 480),
    fov_deg: float = 45.0,
    supersampling: int = 2,
) -> NDArray[np.uint8]:
    """Render a picture.

    Args:
        parts: What can be seen (world.parts()).
        poses: T_base_part by name (world.part_poses()); parts without a pose are left out.
        eye: (3,) where the picture is taken from, in base [m].
        target: (3,) what is in its middle [m].
        size: Width, height [pixels].
        fov_deg: Vertical field of view.
        supersampling: Rays per pixel and direction; 1 is four times faster than 2, and jagged.

    Returns:
        (height, width, 3) uint8 RGB.
    """
    width, height = size[0] * supersampling, size[1] * supersampling
    focal = height / 2 / float(np.tan(np.deg2rad(fov_deg) / 2))
    lens = Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    camera = look_at(eye, target)
    directions = lens.directions().reshape(-1, 3) @ camera[:3, :3].T
    scene, colors = _scene(parts, poses)
    origin = np.broadcast_to(camera[:3, 3], directions.shape)
    rays = np.concatenate([origin, directions], axis=1).astype(np.float32)
    answer = {key: value.numpy() for key, value in scene.cast_rays(tensor(rays)).items()}
    picture = _background(directions)
    hit = np.isfinite(answer["t_hit"])
    points = rays[hit, :3] + rays[hit, 3:] * answer["t_hit"][hit, None]
    normals = answer["primitive_normals"][hit].astype(float)
    # Meshes found in the wild are wound either way: a face is lit from the side it is seen.
    normals *= np.where(np.sum(normals * directions[hit], axis=1) > 0, -1.0, 1.0)[:, None]
    picture[hit] = _shade(scene, points, normals, colors[answer["geometry_ids"][hit]])
    fine = picture.reshape(size[1], supersampling, size[0], supersampling, 3)
    return np.asarray(np.clip(fine.mean(axis=(1, 3)), 0, 1) * 255, dtype=np.uint8)


def _scene(parts: Sequence[Part], poses: Mapping[str, Array]) -> tuple[Any, Array]:
    scene = o3d.t.geometry.RaycastingScene()
    colors = []
    for part in parts:
        if part.name not in poses:
            continue
        for mesh in part.meshes:
            if not len(mesh.faces):
                continue
            moved = mesh.transformed(poses[part.name])
            vertices = tensor(moved.vertices.astype(np.float32))
            scene.add_triangles(vertices, tensor(mesh.faces.astype(np.uint32)))
            colors.append(mesh.color or GREY)
    return scene, np.array(colors or [GREY])


def _background(directions: Array) -> Array:
    height = directions[:, 2] / np.linalg.norm(directions, axis=1)
    share = np.clip(height * 1.5 + 0.5, 0, 1)[:, None]
    return np.asarray(_HORIZON * (1 - share) + _SKY * share)


def _shade(scene: Any, points: Array, normals: Array, colors: Array) -> Array:
    facing = normals @ _LIGHT
    starts = points + 1e-3 * normals
    light = np.broadcast_to(_LIGHT, starts.shape)
    shadow_rays = np.concatenate([starts, light], axis=1).astype(np.float32)
    shadowed = scene.test_occlusions(tensor(shadow_rays)).numpy()
    sun = np.where(shadowed, 0.0, np.clip(facing, 0, 1))
    sky = 0.5 + 0.5 * normals[:, 2]
    brightness = 0.32 + 0.23 * sky + 0.55 * sun
    return np.asarray(colors * brightness[:, None])
