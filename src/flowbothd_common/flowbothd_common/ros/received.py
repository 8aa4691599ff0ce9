"""The entrance for messages: each becomes a checked value, or counts as not received.

Every function raises InvalidMessageError with what is wrong; `ros.guard.Guard` turns that into a
line on /diagnostics, and the rules for silent inputs do the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState, PointCloud2
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

from flowbothd_common.errors import InvalidMessageError
from flowbothd_common.motion import JointTrajectory, MotionResult, joint_order
from flowbothd_common.ros import clouds
from flowbothd_common.ros.conversions import from_result, from_wrench, to_seconds
from flowbothd_common.types import Array, Cloud, as_cloud
from flowbothd_common.values import bounded, finite
from flowbothd_interfaces.msg import MotionResult as MotionResultMessage

_BEYOND_POSITION = 0.5
"""Distance beyond a joint's range that no calibration offset explains [rad]."""
_JITTER = 0.1
"""Joint motion between two messages that arrive together after a delay, at most [rad]."""
_LARGEST_WRENCH = 1.0e4
"""Component of a wrench that no sensor on a tool's scale measures [N, Nm]."""
_AHEAD = 1.0
"""Difference of two synchronised clocks and a long way, at most [s]."""
_CLOCKS = "synchronise the computers' clocks, and set use_sim_time alike everywhere"
_BEYOND_VELOCITY = 10.0
"""Multiple of a joint's velocity limit that no measurement noise explains."""


def frame(name: str, given: str, wanted: str) -> None:
    """Check the frame of a message; an empty frame id counts as the wanted one.

    Raises:
        InvalidMessageError: another frame.
    """
    if given not in ("", wanted):
        raise InvalidMessageError(f"{name} is in another frame", got=repr(given), allowed=wanted)


def joint_state(
    message: JointState,
    names: Sequence[str],
    limits: tuple[Array, Array, Array] | None = None,
    *,
    expected: bool = False,
) -> tuple[Array, Array] | None:
    """Return positions [rad] and velocities [rad/s], (J,) each, in the order of `names`.

    Velocities are zero where the message has none, which ROS allows.

    Args:
        message: Of any joints, in any order.
        names: J joints wanted.
        limits: Lower and upper position and largest velocity, (J,) each; None = not checked.
        expected: No message with a wanted joint has come yet, so that one of other joints alone is
            an error, too.

    Returns:
        None for a message about other joints alone, such as a gripper's on the same topic.

    Raises:
        InvalidMessageError: a wanted joint is missing, fewer values than names, values that are
            not finite, or far outside the limits.
    """
    if message.name and not expected and not set(names) & set(message.name):
        return None
    try:
        order = joint_order(names, message.name)
    except KeyError as error:
        raise InvalidMessageError(f"joint state is incomplete: {error.args[0]}") from error
    count = len(message.name)
    positions = finite("joint positions", message.position, count)[order]
    velocities = np.zeros(len(order))
    if len(message.velocity):
        velocities = finite("joint velocities", message.velocity, count)[order]
    if limits is not None:
        _check_plausible(names, positions, velocities, limits)
    return positions, velocities


def _check_plausible(
    names: Sequence[str], positions: Array, velocities: Array, limits: tuple[Array, Array, Array]
) -> None:
    lower, upper, fastest = limits
    beyond = np.maximum(lower - positions, positions - upper)
    worst = int(np.argmax(beyond))
    if not beyond[worst] <= _BEYOND_POSITION:
        raise InvalidMessageError(
            f"{names[worst]} is far outside its range",
            got=f"{positions[worst]:.4g} rad",
            allowed=f"{lower[worst]:.4g} .. {upper[worst]:.4g} rad",
        )
    ratio = np.abs(velocities) / fastest
    worst = int(np.argmax(ratio))
    if not ratio[worst] <= _BEYOND_VELOCITY:
        raise InvalidMessageError(
            f"{names[worst]} is faster than it can be",
            got=f"{velocities[worst]:.4g} rad/s",
            allowed=f"at most {fastest[worst]:.4g} rad/s",
        )


def no_leap(
    names: Sequence[str], before: Array, positions: Array, fastest: Array, elapsed: float
) -> None:
    """Refuse positions that the joints cannot have reached since the last accepted ones.

    A glitch of an encoder is refused once. Where the arm really is elsewhere, it becomes plausible
    with the time that passes.

    Args:
        names: J joints.
        before: (J,) last accepted positions [rad].
        positions: (J,) new positions [rad].
        fastest: (J,) velocity limits [rad/s].
        elapsed: Time between both [s].

    Raises:
        InvalidMessageError: a joint leaps.
    """
    excess = np.abs(positions - before) - _JITTER - 2.0 * fastest * elapsed
    worst = int(np.argmax(excess))
    if not excess[worst] <= 0.0:
        raise InvalidMessageError(
            f"{names[worst]} leaps",
            got=f"{positions[worst] - before[worst]:.3f} rad in {elapsed:.3f} s",
            allowed=f"{fastest[worst]:.3g} rad/s",
        )


def wrench(message: WrenchStamped, wanted_frame: str) -> Array:
    """Return the (6,) force [N] and torque [Nm] of a message in `wanted_frame`.

    Raises:
        InvalidMessageError: another frame, or values that are not finite or beyond any sensor.
    """
    frame("wrench", message.header.frame_id, wanted_frame)
    values = finite("force and torque", from_wrench(message.wrench), 6)
    bounded("largest force or torque", float(np.abs(values).max()), 0.0, _LARGEST_WRENCH)
    return values


def object_cloud(message: PointCloud2, base_frame: str) -> Cloud:
    """Return the (N, 3) float32 points of an object cloud in `base_frame`; N may be 0.

    Raises:
        InvalidMessageError: another frame; a cloud must name its frame.
        InvalidCloudError: fields, layout or values that cannot be used.
    """
    if message.header.frame_id != base_frame:
        raise InvalidMessageError(
            "object cloud is in another frame",
            got=repr(message.header.frame_id),
            allowed=base_frame,
            hint="set base_frame of both nodes alike",
        )
    values = clouds.from_cloud_message(message, clouds.XYZ).reshape(-1, 3)
    return as_cloud(values, "object cloud", min_points=0)


def trajectory(message: JointTrajectoryMessage, names: Sequence[str]) -> JointTrajectory:
    """Return a trajectory of exactly the joints `names`, in their order.

    Raises:
        InvalidMessageError: no points, other joints, a row of positions, velocities or
            accelerations that is missing or short, values that are not finite, or times that do
            not increase from above 0.
    """
    given = list(message.joint_names)
    if sorted(given) != sorted(names):
        raise InvalidMessageError(
            "trajectory of other joints",
            got=", ".join(given) or "none",
            allowed=f"{', '.join(names)}, each once",
        )
    if not message.points:
        raise InvalidMessageError("trajectory has no points", allowed="at least 1")
    order = joint_order(names, given)
    rows = {
        field: np.array(
            [
                finite(f"{field} of point {k}", getattr(point, field), len(given))[order]
                for k, point in enumerate(message.points)
            ]
        )
        for field in ("positions", "velocities", "accelerations")
    }
    times = np.array([to_seconds(point.time_from_start) for point in message.points])
    if not (times[0] > 0 and (np.diff(times) > 0).all()):
        raise InvalidMessageError(
            "times of the trajectory do not increase from above 0", got=np.round(times[:5], 4)
        )
    return JointTrajectory(
        tuple(names), times, rows["positions"], rows["velocities"], rows["accelerations"]
    )


def motion_result(message: MotionResultMessage) -> MotionResult:
    """Return the outcome of a motion.

    Raises:
        InvalidMessageError: an unknown motion or reason, or numbers that are not finite.
    """
    try:
        result = from_result(message)
    except ValueError as error:
        raise InvalidMessageError(f"motion result cannot be read: {error}") from error
    finite("numbers of the motion result", [result.reached_fraction, result.duration])
    finite("poses of the tool", np.concatenate([result.tool_start, result.tool_end]).ravel())
    finite("peak force and torque", result.peak_wrench, 6)
    return result


def not_ahead(stamp: float, now: float) -> None:
    """Refuse a stamp of another clock: one in the future hides every message after it.

    Args:
        stamp: Of the message [s].
        now: Node clock [s].

    Raises:
        InvalidMessageError: it lies more than a second ahead.
    """
    if not stamp - now <= _AHEAD:
        raise InvalidMessageError(f"stamped {stamp - now:.1f} s in the future", hint=_CLOCKS)


class StampCheck:
    """Refuses messages stamped far from the node's clock, or before one that was accepted.

    A stamp of zero means "not set" in ROS; such a message is timed by its arrival.

    Args:
        tolerance: Accepted difference from the node's clock, either way [s].
    """

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance
        self._last: dict[str, float] = {}

    def check(self, name: str, stamp: Time, now: float) -> None:
        """Check one stamp and remember it; call it after all other checks have passed.

        Args:
            name: Topic.
            stamp: Of the message.
            now: Node clock [s].

        Raises:
            InvalidMessageError: too old, in the future, or out of order.
        """
        at = to_seconds(stamp)
        if at == 0.0:
            return
        off = at - now
        if not abs(off) <= self._tolerance:
            raise InvalidMessageError(
                f"{name} is stamped {abs(off):.1f} s in the {'future' if off > 0 else 'past'}",
                allowed=f"within {self._tolerance:g} s of this node's clock",
                hint=_CLOCKS,
            )
        last = self._last.get(name)
        # After the clock itself has jumped back, the order begins again.
        if last is not None and at < last <= now + self._tolerance:
            raise InvalidMessageError(
                f"{name} is stamped before the last one", got=f"{at - last:.3f} s"
            )
        self._last[name] = at
