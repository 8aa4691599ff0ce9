"""Between ROS messages and the project's value types; clouds are in `clouds`."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3, Wrench
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage
from trajectory_msgs.msg import JointTrajectoryPoint

from flowbothd_common.errors import MotionRejectedError
from flowbothd_common.motion import (
    JointTrajectory,
    MotionGoal,
    MotionKind,
    MotionReason,
    MotionResult,
)
from flowbothd_common.transforms import quaternion_from_rotation, rotation_from_quaternion, unit
from flowbothd_common.types import Array, JointEstimate, JointKind
from flowbothd_interfaces.msg import JointEstimate as JointEstimateMessage
from flowbothd_interfaces.msg import MotionResult as MotionResultMessage

_JOINT_KINDS = {
    JointEstimateMessage.PRISMATIC: JointKind.PRISMATIC,
    JointEstimateMessage.REVOLUTE: JointKind.REVOLUTE,
}


def to_seconds(stamp: Time) -> float:
    """Seconds of a stamp or duration message."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def to_stamp(seconds: float) -> Time:
    """Stamp message of `seconds` >= 0, to the nanosecond."""
    nanoseconds = round(seconds * 1e9)
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def to_point(vector: Array) -> Point:
    """Point message of a (3,) vector."""
    return Point(x=float(vector[0]), y=float(vector[1]), z=float(vector[2]))


def to_vector3(vector: Array) -> Vector3:
    """Vector3 message of a (3,) vector."""
    return Vector3(x=float(vector[0]), y=float(vector[1]), z=float(vector[2]))


def from_xyz(message: Point | Vector3) -> Array:
    """(3,) vector of a Point or Vector3 message."""
    return np.array([message.x, message.y, message.z])


def to_pose(matrix: Array) -> Pose:
    """Pose message of a (4, 4) transform."""
    x, y, z, w = (float(value) for value in quaternion_from_rotation(matrix[:3, :3]))
    return Pose(position=to_point(matrix[:3, 3]), orientation=Quaternion(x=x, y=y, z=z, w=w))


def from_pose(message: Pose) -> Array:
    """(4, 4) transform of a Pose message.

    Raises:
        ValueError: the quaternion has no length.
    """
    q = message.orientation
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_quaternion((q.x, q.y, q.z, q.w))
    matrix[:3, 3] = from_xyz(message.position)
    return matrix


def to_wrench(vector: Array) -> Wrench:
    """Wrench message of a (6,) force and torque."""
    return Wrench(force=to_vector3(vector[:3]), torque=to_vector3(vector[3:]))


def from_wrench(message: Wrench) -> Array:
    """(6,) force and torque of a Wrench message."""
    return np.concatenate([from_xyz(message.force), from_xyz(message.torque)])


def to_joint_estimate(joint: JointEstimate | None) -> JointEstimateMessage:
    """Return the message of a joint estimate; kind NONE if nothing is known."""
    if joint is None:
        return JointEstimateMessage(kind=JointEstimateMessage.NONE)
    return JointEstimateMessage(
        kind=getattr(JointEstimateMessage, joint.kind.name),
        point=to_point(joint.point),
        axis=to_vector3(joint.axis),
    )


def from_joint_estimate(message: JointEstimateMessage) -> JointEstimate | None:
    """Return the joint estimate, or None for kind NONE.

    Raises:
        MotionRejectedError: an unknown kind, an axis without length, or a point that is not finite.
    """
    if message.kind == JointEstimateMessage.NONE:
        return None
    if message.kind not in _JOINT_KINDS:
        raise MotionRejectedError(
            "joint estimate of unknown kind", got=message.kind, allowed="0, 1, 2"
        )
    try:
        axis = unit(from_xyz(message.axis))
    except ValueError as error:
        raise MotionRejectedError(f"joint estimate without an axis: {error}") from error
    point = from_xyz(message.point)
    if not np.isfinite(point).all():
        raise MotionRejectedError("point of the joint estimate is not finite", got=point.tolist())
    return JointEstimate(_JOINT_KINDS[message.kind], axis, point)


def checked_direction(message: Vector3) -> Array:
    """Unit direction of a goal.

    Raises:
        MotionRejectedError: zero length or not finite.
    """
    try:
        return unit(from_xyz(message))
    except ValueError as error:
        raise MotionRejectedError(f"goal without a direction: {error}") from error


def to_goal(kind: MotionKind, goal: object) -> MotionGoal:
    """MotionGoal of an Approach, Probe, FlowStep or Retreat goal message.

    Raises:
        MotionRejectedError: a direction without length, a point that is not finite, a negative
            distance.
    """
    contact = from_xyz(goal.contact) if hasattr(goal, "contact") else None
    if contact is not None and not np.isfinite(contact).all():
        raise MotionRejectedError("contact point is not finite", got=contact.tolist())
    distance = float(getattr(goal, "distance", getattr(goal, "max_distance", 0.0)))
    if not (np.isfinite(distance) and distance >= 0):
        raise MotionRejectedError("distance of a goal", got=distance, allowed=">= 0")
    return MotionGoal(
        kind=kind,
        contact=contact,
        direction=checked_direction(goal.direction) if hasattr(goal, "direction") else None,
        distance=distance,
        joint=from_joint_estimate(goal.joint) if hasattr(goal, "joint") else None,
    )


def to_result(header: Header, result: MotionResult) -> MotionResultMessage:
    """MotionResult message."""
    return MotionResultMessage(
        header=header,
        motion=result.kind.value,
        reason=result.reason.value,
        message=result.message,
        reached_fraction=float(result.reached_fraction),
        tool_start=to_pose(result.tool_start),
        tool_end=to_pose(result.tool_end),
        contact=bool(result.contact),
        vacuum=bool(result.vacuum),
        peak_wrench=to_wrench(result.peak_wrench),
        max_lag=float(result.max_lag),
        duration=float(result.duration),
    )


def from_result(message: MotionResultMessage) -> MotionResult:
    """MotionResult of its message."""
    return MotionResult(
        kind=MotionKind(message.motion),
        reason=MotionReason(message.reason),
        message=message.message,
        reached_fraction=message.reached_fraction,
        tool_start=from_pose(message.tool_start),
        tool_end=from_pose(message.tool_end),
        contact=message.contact,
        vacuum=message.vacuum,
        peak_wrench=from_wrench(message.peak_wrench),
        max_lag=message.max_lag,
        duration=message.duration,
    )


def to_trajectory(trajectory: JointTrajectory) -> JointTrajectoryMessage:
    """JointTrajectory message with stamp 0, which controllers read as "start now"."""
    message = JointTrajectoryMessage(joint_names=list(trajectory.joint_names))
    rows = zip(
        trajectory.times,
        trajectory.positions,
        trajectory.velocities,
        trajectory.accelerations,
        strict=True,
    )
    for time, position, velocity, acceleration in rows:
        nanoseconds = round(float(time) * 1e9)
        message.points.append(
            JointTrajectoryPoint(
                positions=position.tolist(),
                velocities=velocity.tolist(),
                accelerations=acceleration.tolist(),
                time_from_start=Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9),
            )
        )
    return message


def from_trajectory(message: JointTrajectoryMessage) -> JointTrajectory:
    """Trajectory of a message; rows that are not all given become arrays of size 0."""
    points = message.points

    def rows(name: str) -> Array:
        values = [list(getattr(point, name)) for point in points]
        lengths = {len(row) for row in values}
        # Ragged rows keep a shape that matches nothing, so the next check reports them.
        return np.array(values) if len(lengths) == 1 else np.full((len(values), 0), np.nan)

    return JointTrajectory(
        tuple(message.joint_names),
        np.array([to_seconds(point.time_from_start) for point in points]),
        rows("positions"),
        rows("velocities"),
        rows("accelerations"),
    )
