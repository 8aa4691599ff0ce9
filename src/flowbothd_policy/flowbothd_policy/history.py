"""Memory of past steps: the consistency direction and the network's history."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flowbothd_common.motion import MotionReason, MotionResult
from flowbothd_common.transforms import angle_between
from flowbothd_common.types import Array, History
from flowbothd_policy.params import PolicyParams

_EARLY = (
    MotionReason.STALLED,
    MotionReason.FORCE_LIMIT,
    MotionReason.SUCTION_LOST,
    MotionReason.TIMEOUT,
    MotionReason.LAGGING,
    MotionReason.STALE_INPUT,
    MotionReason.STOPPED,
)


@dataclass(frozen=True)
class Memory:
    """Algorithm 1's g_his and S_his.

    Attributes:
        direction: (3,) last accepted motion [m], or None.
        earlier: Accepted motions before it.
        history: Observation and prediction behind it, or None.
        updated: Whether the last step changed the history.
    """

    direction: Array | None = None
    earlier: tuple[Array, ...] = ()
    history: History | None = None
    updated: bool = False


def part_motion(result: MotionResult, params: PolicyParams) -> Array:
    """(3,) motion of the part that a flow step's tool motion stands for [m].

    A pull the wrong way stretches the cup and bends the arm by about a centimetre before it
    stalls, as far as epsilon_m; `compliance` is therefore taken off steps that ended early, and
    what is left counts only above epsilon_m: otherwise the stretch of a wrong pull would become
    the direction that all later samples are held to. A step that ran to its end without the part
    moved nothing.
    """
    motion = result.tool_motion.astype(float)
    length = float(np.linalg.norm(motion))
    if not np.isfinite(length) or length == 0:
        return np.zeros(3)
    if result.reason is MotionReason.REACHED:
        return motion if result.vacuum else np.zeros(3)
    left = length - params.compliance
    if result.reason in _EARLY and left > (params.epsilon_m if params.compliance > 0 else 0.0):
        return motion * (left / length)
    return np.zeros(3)


def remember(
    memory: Memory, motion: Array, pull: Array, seen: History, params: PolicyParams
) -> Memory:
    """Algorithm 1's last block: what one executed step leaves behind.

    With the history filter off every step's prediction is remembered; the consistency direction
    is kept under the same rule in both cases. A part may give way across the pull: a drawer that
    is lifted slides out a little. That motion is true, but what was predicted is not, and a
    network that gets it as history repeats it.
    """
    length = float(np.linalg.norm(motion))
    consistent = length > 0 and (
        memory.direction is None or angle_between(motion, memory.direction) < params.history_angle
    )
    counts = consistent and length > params.consistency_min_motion
    direction, earlier = memory.direction, memory.earlier
    if counts:
        earlier = earlier if direction is None else (*earlier, direction)
        direction = motion
    borne_out = consistent and angle_between(motion, pull) <= params.history_agreement
    update = not params.history_filter or (borne_out and length > params.epsilon_m)
    return Memory(direction, earlier, seen if update else memory.history, update)


def is_consistent(
    flow: Array, memory: Memory, params: PolicyParams, *, attached: bool = True
) -> tuple[bool, float]:
    """Compare a flow with the last accepted motion: agreement, and the angle between them [rad].

    The angle is nan while nothing has moved. A part that is no longer held may have fallen back,
    a lid for instance; then the flow may agree with any motion of the run instead.
    """
    if memory.direction is None:
        return True, float("nan")
    angle = angle_between(flow, memory.direction)
    if not attached and params.recontact_consistency == "any":
        angle = min([angle, *(angle_between(flow, motion) for motion in memory.earlier)])
    return (not params.consistency_check or angle < params.consistency_angle), angle
