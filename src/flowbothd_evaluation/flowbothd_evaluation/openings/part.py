"""The moving part as the arm meets it: where to take hold, and the true flow there."""

from __future__ import annotations

import numpy as np

from flowbothd_common.errors import ParameterError
from flowbothd_common.transforms import apply, unit
from flowbothd_common.types import Array, JointEstimate, JointKind
from flowbothd_evaluation.openings.task import Opening
from sim_bridge.scene import ray_scene, tensor

_FAR = 1.0


class TruePart:
    """Truth about the part that an opening moves, in the base frame.

    The part is taken for a plate along the object's axes, as those of all registered objects are.

    Args:
        opening: The task; where its object stands.
    """

    def __init__(self, opening: Opening) -> None:
        self._opening = opening
        model = opening.model()
        self._joint = joint = model.target
        self._pose = pose = opening.T_base_object
        mesh = model.links[joint.child].mesh
        self._scene = ray_scene(mesh)
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        middle = (low + high) / 2
        if joint.kind == "prismatic":
            self._middle = middle
            normal = joint.axis
            self._across = unit(np.cross(joint.axis, (0.0, 0.0, 1.0)))
            self._along = np.cross(self._across, joint.axis)
        else:
            upwards = float(joint.axis @ (0.1, 0.2, 1.0)) > 0
            self._along = joint.axis if upwards else -joint.axis
            self._middle = joint.point + joint.axis * float((middle - joint.point) @ joint.axis)
            normal, self._across = _plate(middle - self._middle, joint.axis, high - low)
        self._face = -normal if opening.front else normal
        corners = np.stack([low, high]) - self._middle
        sides = np.stack([corners @ self._across, corners @ self._along], axis=1)
        self.face = sides.min(axis=0), sides.max(axis=0)
        """Lowest and highest grasp (2,) on the part, see `Opening.grasp` [m]."""
        axis = pose[:3, :3] @ joint.axis
        if joint.kind == "prismatic":
            self.joint_in_base = JointEstimate(JointKind.PRISMATIC, axis, np.zeros(3))
        else:
            self.joint_in_base = JointEstimate(JointKind.REVOLUTE, axis, apply(pose, joint.point))

    def contact(self, offset: Array) -> Array:
        """(3,) the point to take hold of while the part is closed, moved by (2,) on its face [m].

        Raises:
            ParameterError: it is not on the part.
        """
        across, along = np.asarray(self._opening.grasp) + offset
        point = self._middle + across * self._across + along * self._along
        ray = np.concatenate([point + _FAR * self._face, -self._face]).astype(np.float32)
        distance = float(self._scene.cast_rays(tensor(ray[None]))["t_hit"].numpy()[0])
        if not np.isfinite(distance):
            raise ParameterError(
                f"the grasp of {self._opening.name} is not on the part", got=[across, along]
            )
        hit = point + (_FAR - distance) * self._face
        return np.asarray(apply(self._pose, hit))

    @property
    def outward(self) -> Array:
        """(3,) unit normal of the face that is held, while the part is closed, in base."""
        return np.asarray(self._pose[:3, :3] @ self._face)

    def flow(self, point: Array, value: float) -> Array:
        """(3,) unit direction in which the part moves at a point of it, at a joint value.

        Where the cup pushes, the normal of its face: off it the tool would tilt by as much as the
        plate's thickness turns the flow, which is much near the hinge.
        """
        if self._opening.front:
            turned = self._joint.motion(value)[:3, :3] @ -self._face
            return np.asarray(self._pose[:3, :3] @ turned)
        if self.joint_in_base.kind is JointKind.PRISMATIC:
            return self.joint_in_base.axis
        return unit(np.cross(self.joint_in_base.axis, point - self.joint_in_base.point))

    def radius(self, point: Array) -> float:
        """Distance of a point from the axis [m]; infinite for a slide."""
        if self.joint_in_base.kind is JointKind.PRISMATIC:
            return float("inf")
        return float(
            np.linalg.norm(np.cross(self.joint_in_base.axis, point - self.joint_in_base.point))
        )

    def way(self, point: Array, amount: float) -> float:
        """Length of the path of a point while the joint goes on by `amount` [rad or m]."""
        return (
            amount
            if self.joint_in_base.kind is JointKind.PRISMATIC
            else amount * self.radius(point)
        )


def _plate(outward: Array, axis: Array, size: Array) -> tuple[Array, Array]:
    """Normal of a plate on the side it moves to, and the way out from its hinge; object's axes."""
    square = [k for k in range(3) if abs(axis[k]) < 0.5]
    thin, wide = sorted(square, key=lambda k: float(size[k]))
    across, normal = np.zeros(3), np.zeros(3)
    across[wide] = np.sign(outward[wide])
    normal[thin] = np.sign(np.cross(axis, across)[thin])
    return normal, across
