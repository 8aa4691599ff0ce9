"""The policy's events as messages: published by its node, read back for a replay."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Header

from flowbothd_common.ros import qos
from flowbothd_common.ros.conversions import from_result, to_result, to_seconds, to_stamp
from flowbothd_common.types import Cloud, SuctionPhase
from flowbothd_interfaces.msg import PolicyEvent, SuctionState
from flowbothd_policy.events import (
    NAMES,
    CloudArrived,
    Event,
    InputsBack,
    InputsLost,
    MotionFinished,
    OperatorStop,
    PredictionArrived,
    PredictionFailed,
    Start,
    SuctionChanged,
    WaitExpired,
)

_PHASES = {getattr(SuctionState, phase.name): phase for phase in SuctionPhase}
_STATES = {phase: state for state, phase in _PHASES.items()}
_OPENED = {True: 1, False: 0, None: -1}
"""Codes of `opened` in the message: yes, no, not said."""


def phase_of(state: int) -> SuctionPhase:
    """The phase that a SuctionState names; an unknown state is a fault."""
    return _PHASES.get(state, SuctionPhase.FAULT)


class Sights(Protocol):
    """Source of the arrays that a PolicyEvent only names."""

    def cloud(self, stamp: Time) -> Cloud:
        """(N, 3) float32 points of the object cloud with this stamp."""
        ...

    def prediction(self, stamp: Time, seed: int) -> tuple[Cloud, NDArray[np.float32]]:
        """(N, 3) points and (S, N, 3) flows sampled for that cloud with this seed."""
        ...


def to_event_message(event: Event, header: Header, sequence: int) -> PolicyEvent:
    """PolicyEvent message of an event; clouds and predictions are named by stamp and seed."""
    message = PolicyEvent(header=header, sequence=sequence, event=NAMES[type(event)], opened=-1)
    if isinstance(event, CloudArrived | PredictionArrived):
        message.cloud_stamp = to_stamp(event.stamp)
    if isinstance(event, PredictionArrived):
        message.seed, message.model_id = event.seed, event.model_id
    if isinstance(event, PredictionFailed | SuctionChanged):
        message.message = event.message
    if isinstance(event, SuctionChanged):
        message.suction = _STATES[event.phase]
    if isinstance(event, MotionFinished):
        message.result = [to_result(header, event.result)]
    if isinstance(event, InputsLost):
        message.names = list(event.names)
    if isinstance(event, OperatorStop):
        message.message, message.opened = event.reason, _OPENED[event.opened]
    return message


def from_event_message(message: PolicyEvent, sights: Sights) -> Event:
    """Return the event that a PolicyEvent carries.

    Raises:
        KeyError: an unknown event.
    """
    stamp = message.cloud_stamp
    if message.event == NAMES[CloudArrived]:
        return CloudArrived(sights.cloud(stamp), to_seconds(stamp))
    if message.event == NAMES[PredictionArrived]:
        points, flows = sights.prediction(stamp, message.seed)
        return PredictionArrived(points, flows, to_seconds(stamp), message.model_id, message.seed)
    if message.event == NAMES[MotionFinished]:
        return MotionFinished(from_result(message.result[0]))
    if message.event == NAMES[OperatorStop]:
        opened = {number: word for word, number in _OPENED.items()}[message.opened]
        return OperatorStop(message.message, opened)
    plain: dict[str, Event] = {
        NAMES[Start]: Start(),
        NAMES[PredictionFailed]: PredictionFailed(message.message),
        NAMES[SuctionChanged]: SuctionChanged(phase_of(message.suction), message.message),
        NAMES[InputsLost]: InputsLost(tuple(message.names)),
        NAMES[InputsBack]: InputsBack(),
        NAMES[WaitExpired]: WaitExpired(),
    }
    return plain[message.event]


class _Given:
    """The arrays of an event that is at hand."""

    def __init__(self, event: Any) -> None:
        self._event = event

    def cloud(self, stamp: Time) -> Cloud:
        """Its points."""
        points: Cloud = self._event.points
        return points

    def prediction(self, stamp: Time, seed: int) -> tuple[Cloud, NDArray[np.float32]]:
        """Its points and flows."""
        return self._event.points, self._event.flows


class EventLog:
    """Publishes `policy/events`.

    Args:
        node: Gets the publisher; its clock stamps.
        base_frame: Frame of the messages.
    """

    def __init__(self, node: Node, base_frame: str) -> None:
        self._node, self._base_frame = node, base_frame
        self._publisher = node.create_publisher(PolicyEvent, "policy/events", qos.STORY)
        self._sequence = 0

    def note(self, event: Event) -> tuple[Event, float]:
        """Publish an event; return event and time [s] as a reader of the message gets them.

        The policy has to take these and not its own: a pose loses its last bits on the way
        through a quaternion, and a replay from a bag would get other values than the run did.
        """
        stamp = self._node.get_clock().now().to_msg()
        header = Header(stamp=stamp, frame_id=self._base_frame)
        message = to_event_message(event, header, self._sequence)
        self._sequence += 1
        self._publisher.publish(message)
        return from_event_message(message, _Given(event)), to_seconds(stamp)
