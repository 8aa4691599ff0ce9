"""Things that can be seen: named meshes, and their persistent ray-casting scenes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d

from sim_bridge.mesh import Mesh, merge


@dataclass(frozen=True)
class Part:
    """A rigid thing that can be seen.

    Attributes:
        name: Unique in its scene.
        meshes: Coloured meshes in the part's own frame.
    """

    name: str
    meshes: tuple[Mesh, ...]

    @property
    def mesh(self) -> Mesh:
        """All meshes as one."""
        return merge(list(self.meshes))


def ray_scene(mesh: Mesh) -> Any:
    """Open3D ray-casting scene of one mesh, on one thread."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    vertices = tensor(mesh.vertices.astype(np.float32))
    scene.add_triangles(vertices, tensor(mesh.faces.astype(np.uint32)))
    return scene


def tensor(array: Any) -> Any:
    """Open3D tensor of an array; contiguous arrays are not copied."""
    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array))
