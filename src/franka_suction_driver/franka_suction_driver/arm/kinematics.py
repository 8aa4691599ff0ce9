"""Forward and differential kinematics of the arm, one configuration or many at once.

Poses are T_base_tip. The suction cup is symmetric about its axis, so a *tool pose* is the tip's
position and the direction of its z axis: five constraints, and the turn about the axis is free.
Everything takes (..., J) batches: inverse kinematics from a hundred seeds costs little more than
from one, which is what makes choosing the branch for a whole opening affordable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio

from flowbothd_common.errors import ParameterError
from flowbothd_common.types import Array
from franka_suction_driver.arm.description import compose_urdf
from franka_suction_driver.params import MotionParams


@dataclass(frozen=True)
class TipState:
    """Where the tip is and how it moves with the joints.

    Attributes:
        position: (..., 3) in base [m].
        rotation: (..., 3, 3) R_base_tip.
        jacobian: (..., 6, J) linear over angular velocity of the tip, in base axes.
    """

    position: Array
    rotation: Array
    jacobian: Array

    @property
    def axis(self) -> Array:
        """(..., 3) direction of the tool's z axis in base."""
        return np.asarray(self.rotation[..., :, 2])


class Kinematics:
    """Kinematics of a serial arm of revolute joints, read from a URDF by Pinocchio.

    Args:
        urdf: The robot description.
        joint_names: The arm's joints, base to tip; this is the order of all joint vectors.
        base_frame: Frame of all poses.
        tip_frame: Frame at the cup's lip.

    Raises:
        ParameterError: a joint or frame is not in the description, or a joint is not revolute.
    """

    def __init__(
        self, urdf: str, joint_names: Sequence[str], base_frame: str, tip_frame: str
    ) -> None:
        self.urdf = urdf
        self.joint_names = tuple(joint_names)
        self.base_frame = base_frame
        self.tip_frame = tip_frame
        self.model = pinocchio.buildModelFromXML(urdf)
        _require_joints(self.model, self.joint_names)
        self._base = self.model.frames[_frame(self.model, base_frame)]
        self._tip = self.model.frames[_frame(self.model, tip_frame)]
        if self._base.parentJoint != 0:
            raise ParameterError(
                "the base frame moves with the arm", got=base_frame, hint="name a fixed frame"
            )
        self._data = self.model.createData()
        self._tip_id = _frame(self.model, tip_frame)
        self._placements = [self.model.jointPlacements[i] for i in range(1, self.model.njoints)]
        self._axes = [_joint_axis(self.model, i) for i in range(1, self.model.njoints)]

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    def pose(self, q: Array) -> Array:
        """(4, 4) T_base_tip at joint positions (J,)."""
        state = self.tip(q)
        matrix = np.eye(4)
        matrix[:3, :3] = state.rotation
        matrix[:3, 3] = state.position
        return matrix

    def tip(self, q: Array) -> TipState:
        """Pose and Jacobian of the tip at joint positions (..., J)."""
        q = np.asarray(q, dtype=float)
        if q.ndim == 1:
            return self._one_tip(q)
        batch = q.shape[:-1]
        start = self._base.placement.inverse()
        rotation = np.broadcast_to(start.rotation, (*batch, 3, 3))
        position = np.broadcast_to(start.translation, (*batch, 3))
        axes = np.empty((*batch, self.dof, 3))
        origins = np.empty((*batch, self.dof, 3))
        for i, (placement, axis) in enumerate(zip(self._placements, self._axes, strict=True)):
            position = position + rotation @ placement.translation
            rotation = rotation @ placement.rotation
            axes[..., i, :] = rotation @ axis
            origins[..., i, :] = position
            rotation = rotation @ _turns(axis, q[..., i])
        placement = self._tip.placement
        position = position + rotation @ placement.translation
        rotation = rotation @ placement.rotation
        linear = _cross(axes, position[..., None, :] - origins)
        jacobian = np.concatenate([linear, axes], axis=-1).swapaxes(-1, -2)
        return TipState(position, rotation, jacobian)

    def _one_tip(self, q: Array) -> TipState:
        """One configuration is what Pinocchio does fastest."""
        jacobian = pinocchio.computeFrameJacobian(
            self.model, self._data, q, self._tip_id, pinocchio.LOCAL_WORLD_ALIGNED
        )
        to_base = self._base.placement.rotation.T
        placement = self._data.oMf[self._tip_id]
        position = to_base @ (placement.translation - self._base.placement.translation)
        turned = np.concatenate([to_base @ jacobian[:3], to_base @ jacobian[3:]])
        return TipState(position, to_base @ placement.rotation, turned)


def make_kinematics(params: MotionParams, urdf: str | None = None) -> Kinematics:
    """Kinematics of the arm that the parameters name; the description is composed if not given."""
    robot = params.robot
    if urdf is None:
        urdf = compose_urdf(tip_frame=robot.tip_frame, arm=robot.base_frame.partition("_link")[0])
    return Kinematics(urdf, robot.joint_names, robot.base_frame, robot.tip_frame)


def task_jacobian(state: TipState) -> Array:
    """(..., 5, J) rates of tip position (base) and of the tilt about the tip's own x and y."""
    tilt = state.rotation[..., :, :2].swapaxes(-1, -2) @ state.jacobian[..., 3:, :]
    return np.concatenate([state.jacobian[..., :3, :], tilt], axis=-2)


def task_error(state: TipState, position: Array, axis: Array) -> Array:
    """(..., 5) step from `state` to the tool pose: metres, then radians about the tip's x and y.

    Args:
        state: Where the tip is.
        position: (..., 3) wanted tip position in base [m].
        axis: (..., 3) wanted unit direction of the tool's z axis in base.
    """
    sine_vector = _cross(state.axis, np.broadcast_to(axis, state.axis.shape))
    sine = np.linalg.norm(sine_vector, axis=-1, keepdims=True)
    cosine = np.sum(state.axis * axis, axis=-1, keepdims=True)
    # Opposite axes leave the direction of the turn open; any will do, the x axis is taken.
    fallback = np.where(cosine < 0, state.rotation[..., :, 0], 0.0)
    direction = np.where(sine > 1e-9, sine_vector / np.maximum(sine, 1e-12), fallback)
    turn = np.arctan2(sine, cosine) * direction
    tilt = (state.rotation[..., :, :2].swapaxes(-1, -2) @ turn[..., None])[..., 0]
    return np.concatenate([position - state.position, tilt], axis=-1)


def damped_inverse(jacobian: Array, damping: float) -> Array:
    """(..., J, m) damped right pseudo-inverse of (..., m, J)."""
    rows = jacobian.shape[-2]
    transposed = jacobian.swapaxes(-1, -2)
    gram = jacobian @ transposed + damping**2 * np.eye(rows)
    return np.asarray(np.linalg.solve(gram, jacobian).swapaxes(-1, -2))


def conditioning(state: TipState) -> Array:
    """(...,) smallest singular value of the task Jacobian: how far from a singularity [m/rad]."""
    return np.asarray(np.linalg.svd(task_jacobian(state), compute_uv=False)[..., -1])


def _turns(axis: Array, angles: Array) -> Array:
    """(..., 3, 3) rotations about one unit axis by many angles."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, cosine = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    return np.asarray(np.eye(3) + sine * k + (1 - cosine) * (k @ k))


def _cross(a: Array, b: Array) -> Array:
    """Cross product over the last axis; numpy's own is several times slower on small batches."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def _require_joints(model: pinocchio.Model, names: tuple[str, ...]) -> None:
    present = list(model.names)[1:]
    if list(names) != present:
        raise ParameterError(
            "the joint names do not match the robot description",
            got=list(names),
            allowed=present,
            hint="give all movable joints of the description, base to tip",
        )


def _frame(model: pinocchio.Model, name: str) -> int:
    if not model.existFrame(name):
        links = [f.name for f in model.frames if f.type == pinocchio.FrameType.BODY]
        raise ParameterError("unknown frame", got=name, allowed=links)
    return int(model.getFrameId(name))


def _joint_axis(model: pinocchio.Model, index: int) -> Array:
    """Axis of a revolute joint in its own frame, whatever Pinocchio calls the joint's type."""
    joint = model.joints[index]
    if joint.nq != 1 or joint.nv != 1:
        raise ParameterError("only revolute joints are handled", got=joint.shortname())
    data = joint.createData()
    joint.calc(data, np.zeros(model.nq), np.ones(model.nv))
    motion = data.S
    column = np.asarray(motion, dtype=float).reshape(6, -1)[:, 0]
    if np.linalg.norm(column[:3]) > 1e-9:
        raise ParameterError("only revolute joints are handled", got=joint.shortname())
    return np.asarray(column[3:])
