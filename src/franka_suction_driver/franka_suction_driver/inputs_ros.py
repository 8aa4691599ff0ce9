"""Latest checked values of the robot's topics, and which of them cannot be relied on."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState, PointCloud2

from flowbothd_common.errors import FlowBotError, InvalidMessageError, ParameterError
from flowbothd_common.motion import RobotObservation
from flowbothd_common.ros import qos, received
from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.liveness import PeerWatch, Silence
from flowbothd_common.ros.node_clock import NodeClock
from flowbothd_common.types import Array, Cloud
from flowbothd_interfaces.msg import SuctionState
from franka_suction_driver.arm.limits import JointLimits
from franka_suction_driver.params import MotionNodeParams

JOINT_STATES = "joint_states"
WRENCH = "external_wrench"
SUCTION = "suction/state"


class RobotInputs:
    """Latest joint states, wrench, suction state and object cloud.

    A message that is malformed counts as not received: see `received`.

    Args:
        node: Subscribes on it.
        params: Names, frames, timeouts and the wrench's sign.
        limits: Positions and velocities far outside them are no measurement.
        guard: Takes refused messages to diagnostics.
        refused: Called after every refused message, so that the arm need not wait for a timer.

    Raises:
        ParameterError: `wrench.sign` is neither 1.0 nor -1.0.
    """

    def __init__(
        self,
        node: Node,
        params: MotionNodeParams,
        limits: JointLimits,
        guard: Guard,
        refused: Callable[[], None],
    ) -> None:
        if params.wrench.sign not in (1.0, -1.0):
            raise ParameterError("wrench.sign", got=params.wrench.sign, allowed="1.0 or -1.0")
        self._names = params.robot.joint_names
        self._base_frame = params.robot.base_frame
        self._wrench_frame = params.wrench.frame or params.robot.base_frame
        self._sign = params.wrench.sign
        self._refused = refused
        self._limits = (limits.lower, limits.upper, limits.velocity)
        self._clock = NodeClock(node, params.clock_timeout)
        self._stamps = received.StampCheck(params.stamp_tolerance)
        self._silence = Silence(params.input_timeout)
        # A free motion can be had without a wrench: an arm that dies is named by its joint states.
        self._free_silence = Silence(2.0 * params.input_timeout)
        self._suction_silence = Silence(params.watch_timeout)
        self._ready = frozenset(params.ready_nodes)
        self._peers = PeerWatch(node, params.watch_nodes, params.watch_timeout)
        self._positions: Array | None = None
        self._velocities: Array = np.zeros(len(self._names))
        self._wrench: Array | None = None
        self._vacuum = self._vacuum_lost = False
        self.cloud: Cloud | None = None

        def listen(kind: type, topic: str, take: Callable[[Any], None], quality: Any) -> None:
            guard.subscribe(kind, topic, partial(self._take, topic, take), quality)

        listen(JointState, JOINT_STATES, self._on_joints, qos.STATE)
        # Franka's drivers publish wrenches best effort: a reliable reader would get nothing.
        listen(WrenchStamped, WRENCH, self._on_wrench, qos.SENSOR)
        listen(SuctionState, SUCTION, self._on_suction, qos.STATE)
        listen(PointCloud2, "object_cloud", self._on_cloud, qos.IMAGE)

    def observation(self) -> RobotObservation | None:
        """Return what is known of the robot now; None before any joint state.

        Its time is the node clock's, or runs on with the steady clock where that stands still. The
        wrench is None where it is silent or its last message was refused.
        """
        if self._positions is None:
            return None
        silent = self._silence.silent([WRENCH]) or self._silence.last_refused(WRENCH)
        return RobotObservation(
            self._clock.now(),
            self._positions,
            self._velocities,
            None if silent else self._wrench,
            self._vacuum,
            self._vacuum_lost,
        )

    def wrench_known(self) -> bool:
        """Return whether a wrench arrives."""
        return self._wrench is not None and not self._silence.silent([WRENCH])

    def stale(self, *, guarded: bool, wrench: bool = False) -> str:
        """Return which inputs cannot be relied on, in words; empty if none.

        Args:
            guarded: The motion needs the external wrench and the suction state, too.
            wrench: It began with an external wrench and must not go on without it.
        """
        needed = [JOINT_STATES, WRENCH] if guarded else [JOINT_STATES]
        parts = [self._silence.why(name) for name in self._silence.silent(needed)]
        if wrench and not guarded and self._free_silence.silent([WRENCH]):
            parts.append(self._free_silence.why(WRENCH))
        if guarded:
            silent = self._suction_silence.silent([SUCTION])
            parts += [self._suction_silence.why(name) for name in silent]
        parts += [f"{name} {problem}" for name, problem in self._lost_peers().items()]
        clock = self._clock.problem()
        return ", ".join([clock, *parts] if clock else parts)

    def _lost_peers(self) -> dict[str, str]:
        """Watched nodes that are silent, and of the arm's nodes those that are not ready."""
        stopping = set(self._peers.silent()) | self._ready
        return {name: text for name, text in self._peers.missing().items() if name in stopping}

    def _take(self, topic: str, take: Callable[[Any], None], message: Any) -> None:
        """Take a message in; a refused one breaks the silence of its topic no more than none."""
        try:
            take(message)
        except FlowBotError as error:
            for silence in (self._silence, self._free_silence, self._suction_silence):
                silence.refused(topic, str(error))
            self._refused()
            raise

    def _on_joints(self, message: JointState) -> None:
        first = self._positions is None
        values = received.joint_state(message, self._names, self._limits, expected=first)
        if values is None:
            return
        if self._positions is not None:
            elapsed = self._silence.age(JOINT_STATES)
            received.no_leap(self._names, self._positions, values[0], self._limits[2], elapsed)
        self._stamps.check(JOINT_STATES, message.header.stamp, self._clock.now())
        self._positions, self._velocities = values
        self._silence.heard(JOINT_STATES)

    def _on_wrench(self, message: WrenchStamped) -> None:
        values = received.wrench(message, self._wrench_frame)
        self._stamps.check(WRENCH, message.header.stamp, self._clock.now())
        self._wrench = self._sign * values
        self._silence.heard(WRENCH)
        self._free_silence.heard(WRENCH)

    def _on_suction(self, message: SuctionState) -> None:
        if message.state > SuctionState.FAULT:
            raise InvalidMessageError("suction state", got=message.state, allowed="0 .. 4")
        self._vacuum = message.state == SuctionState.HOLDING
        self._vacuum_lost = message.state == SuctionState.LOST
        self._suction_silence.heard(SUCTION)

    def _on_cloud(self, message: PointCloud2) -> None:
        self.cloud = received.object_cloud(message, self._base_frame)
