"""True articulation flow: how every point would move if the object opened a little further."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.transforms import apply, inverse
from flowbothd_common.types import Array, Cloud, as_cloud
from sim_bridge.objects.model import Joint, ObjectModel
from sim_bridge.oracle import GroundTruthFlow
from sim_bridge.scene import ray_scene, tensor

STEP = 0.01
"""How far each joint is moved for its flow [rad or m]."""

FAR = 0.04
"""Points further than this from the object do not belong to it [m]."""


class FlowOracle:
    """Ground-truth flow of any cloud of one object."""

    def __init__(self, model: ObjectModel) -> None:
        self._model = model
        self._scenes: dict[str, Any] = {}
        for name, link in model.links.items():
            self._scenes[name] = ray_scene(link.mesh)

    def flow(
        self,
        points: object,
        pose: Array,
        positions: Mapping[str, float],
        *,
        target_only: bool = False,
    ) -> GroundTruthFlow:
        """Flow of a cloud.

        Every movable joint advances by STEP from where it stands, limits or not; the displacements
        that this gives to the links it carries are summed, as the reference does it.

        Args:
            points: (N, 3) in base [m].
            pose: T_base_object.
            positions: Of all movable joints.
            target_only: Let only the target joint move.

        Raises:
            InvalidCloudError: not (N, 3), empty, or not finite.
        """
        cloud = as_cloud(points)
        local = apply(inverse(pose), cloud.astype(np.float64))
        owners = self.owners(cloud, pose, positions)
        model = self._model
        joints = [model.target] if target_only else list(model.joints.values())
        names, flows = [model.mode or "truth"], [self._flow(local, owners, positions, joints)]
        for mode, joint in model.alternatives.items():
            if mode != model.mode:
                names.append(mode)
                flows.append(self._flow(local, owners, positions, [joint]))
        turned = np.stack([flow @ pose[:3, :3].T for flow in flows])
        largest = np.linalg.norm(turned, axis=2).max(axis=1)[:, None, None]
        normalised = np.divide(turned, largest, out=np.zeros_like(turned), where=largest > 0)
        ratio = model.target.open_ratio(positions[model.target_joint])
        return GroundTruthFlow(normalised.astype(np.float32), tuple(names), ratio)

    def owners(
        self, cloud: Cloud, pose: Array, positions: Mapping[str, float]
    ) -> NDArray[np.int64]:
        """(N,) index of the nearest link in the order of `model.links`; -1 if none is near."""
        local = apply(inverse(pose), cloud.astype(np.float64))
        distances = []
        for name in self._model.links:
            back = inverse(self._model.displacement(name, positions))
            query = tensor(apply(back, local).astype(np.float32))
            distances.append(self._scenes[name].compute_distance(query, nthreads=1).numpy())
        table = np.stack(distances, axis=1)
        nearest: NDArray[np.int64] = table.argmin(axis=1)
        nearest[table.min(axis=1) > FAR] = -1
        return nearest

    def _flow(
        self,
        local: Array,
        owners: NDArray[np.int64],
        positions: Mapping[str, float],
        joints: list[Joint],
    ) -> Array:
        flow = np.zeros_like(local)
        for index, (name, link) in enumerate(self._model.links.items()):
            mine = owners == index
            if not (mine.any() and link.joints):
                continue
            for joint in joints:
                if joint.name in link.joints:
                    little = self._little_motion(name, joint, positions)
                    flow[mine] += apply(little, local[mine]) - local[mine]
        return flow

    def _little_motion(self, link: str, joint: Joint, positions: Mapping[str, float]) -> Array:
        """Motion of a link, in the object frame, when a joint above it advances by STEP.

        With A the motion of everything above the joint and of the joint itself up to now, the
        screw stands at A(screw), and the little motion is A exp(screw STEP) A^-1.
        """
        carried = np.eye(4)
        for name in self._model.links[link].joints:
            held = self._model.joints[name]
            carried = carried @ held.motion(positions[name])
            if name == joint.name:
                break
        return np.asarray(carried @ joint.motion(STEP) @ inverse(carried))
