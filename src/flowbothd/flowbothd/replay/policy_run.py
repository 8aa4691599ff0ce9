"""The policy once more on its recorded inputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray

from flowbothd.replay.differences import Comparison, compare_fields
from flowbothd.replay.story import EVENTS, Stamp, Story, key
from flowbothd_common.parameters import build, specifications
from flowbothd_common.ros.conversions import to_seconds
from flowbothd_common.types import Cloud
from flowbothd_policy.actuators_ros import to_decision_message
from flowbothd_policy.commands import Decision, Predict
from flowbothd_policy.events_ros import from_event_message
from flowbothd_policy.params import PolicyNodeParams, PolicyParams
from flowbothd_policy.state import PolicyState
from flowbothd_policy.state_machine import advance
from flowbothd_rosbag.metadata import BagError


class Source(Protocol):
    """Source of clouds and predictions: the recording, or a computation."""

    def cloud(self, stamp: Stamp) -> Cloud:
        """(N, 3) float32 points of the object cloud with this stamp."""
        ...

    def prediction(self, stamp: Stamp, seed: int, asked: Predict | None) -> Sample:
        """Points and flows for this stamp and seed; `asked` is what the policy asked for."""
        ...


Sample = tuple[Cloud, NDArray[np.float32]]


class _Sights:
    """Arrays that the inputs refer to, from a source."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self.asked: Predict | None = None

    def cloud(self, stamp: Time) -> Cloud:
        """Points of the cloud."""
        return self._source.cloud(key(stamp))

    def prediction(self, stamp: Time, seed: int) -> Sample:
        """Points and flows of the prediction."""
        return self._source.prediction(key(stamp), seed, self.asked)


def policy_params(story: Story) -> PolicyParams:
    """The parameters that the policy had.

    Raises:
        BagError: they were not recorded.
    """
    if "policy_node" not in story.parameters:
        raise BagError(
            "the recording has no parameters of policy_node",
            hint="record with `flowbothd record`, which asks all nodes for theirs",
        )
    known = {spec.name for spec in specifications(PolicyNodeParams)}
    values = {k: v for k, v in story.parameters["policy_node"].items() if k in known}
    return build(PolicyNodeParams, values)


def decide_again(story: Story, source: Source) -> Iterator[Decision]:
    """Decisions of the policy on the recorded events, in order.

    Raises:
        BagError: what an event names, or the policy's parameters, were not recorded.
    """
    params, state, sights = policy_params(story), PolicyState(), _Sights(source)
    for message in story.events:
        event = from_event_message(message, sights)
        state, commands = advance(state, event, to_seconds(message.header.stamp), params)
        for command in commands:
            if isinstance(command, Predict):
                sights.asked = command
            elif isinstance(command, Decision):
                yield command


def compare_decisions(story: Story, decisions: Sequence[Decision]) -> Comparison:
    """Recorded decisions against recomputed ones, all fields, exactly."""
    result = Comparison("policy", problems=gaps(story))
    frame = story.decisions[0].header.frame_id if story.decisions else ""
    for number, recorded in enumerate(story.decisions):
        stamp = to_seconds(recorded.header.stamp)
        what = f"decision {recorded.sequence} ({recorded.decision})"
        again = (
            fields(to_decision_message(decisions[number], frame)) if number < len(decisions) else {}
        )
        result.add(compare_fields(stamp, what, fields(recorded), again))
    extra = len(decisions) - len(story.decisions)
    if extra > 0:
        first = decisions[len(story.decisions)]
        result.problems.append(
            f"{extra} decisions more than recorded, the first at {first.time:.9f} s: "
            f"{first.decision} ({first.reason})"
        )
    if not story.decisions:
        result.problems.append("the recording holds no decisions")
    return result


def gaps(story: Story) -> list[str]:
    """Describe the gaps in the recorded events, for people."""
    numbers = [m.sequence for m in story.events]
    if not numbers:
        return [
            f"the recording has no {EVENTS}: it was made before they were published, without the "
            "policy, or by something else than `flowbothd record`"
        ]
    problems = []
    if numbers[0] != 0:
        problems.append(
            f"{numbers[0]} events came before the recording began: start it before the run"
        )
    holes = [a for a, b in pairwise(numbers) if b != a + 1]
    if holes:
        problems.append(f"events are missing after number {holes[0]}")
    return problems


def fields(message: Any) -> dict[str, Any]:
    """Flat description of a PolicyDecision: names with dots -> plain values."""
    result: dict[str, Any] = {}
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            result |= {f"{name}.{inner}": v for inner, v in fields(value).items()}
        else:
            result[name] = value
    return result
