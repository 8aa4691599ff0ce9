"""Content of a recording: events, decisions, clouds, predictions, parameters."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from flowbothd_common.ros import clouds
from flowbothd_common.types import Cloud
from flowbothd_rosbag.attached import stored_parameters, stored_weights
from flowbothd_rosbag.lookup import topic_called
from flowbothd_rosbag.metadata import BagError
from flowbothd_rosbag.reader import Bag, Message, Span
from flowbothd_rosbag.types_ros import message_class
from sim_bridge.oracle import ORACLES

EVENTS, DECISIONS = "policy/events", "policy/decisions"
CLOUD, PREDICTION = "object_cloud", "flow/prediction"
TRUTH = "sim/ground_truth_flow/_service_event"
INFERENCE_NODE, ORACLE_NODE = "inference_node", "oracle_node"

Stamp = tuple[int, int]
"""Seconds and nanoseconds, as in the message: exact."""


def key(stamp: Time) -> Stamp:
    """The stamp as a dictionary key."""
    return stamp.sec, stamp.nanosec


def seconds(stamp: Stamp) -> float:
    """The stamp as one number [s]."""
    return stamp[0] + 1e-9 * stamp[1]


def decoded(bag: Bag, message: Message) -> Any:
    """The message as an object.

    Raises:
        BagError: its type is not installed, or it is damaged.
    """
    kind = bag.topics[message.topic].type
    try:
        return deserialize_message(message.data, message_class(kind))
    except BagError:
        raise
    except Exception as error:
        # What rmw raises for bytes of another definition is a bare RuntimeError or worse.
        raise BagError(
            f"a message on {message.topic} cannot be read as {kind}",
            got=error,
            hint="was it recorded with another version of the type?",
        ) from error


@dataclass
class Story:
    """The part of a recording that the policy's decisions depend on.

    Attributes:
        events: PolicyEvent messages, in order.
        decisions: PolicyDecision messages, in order.
        clouds: (N, 3) object clouds by stamp.
        predictions: FlowPrediction messages by stamp of the cloud and seed, in order.
        truths: The simulation's answers by stamp of the cloud.
        parameters: Node -> parameter -> value.
        weights: What the recorder knew of the weights, by node.
    """

    events: list[Any] = field(default_factory=list)
    decisions: list[Any] = field(default_factory=list)
    clouds: dict[Stamp, Cloud] = field(default_factory=dict)
    predictions: dict[tuple[Stamp, int], list[Any]] = field(
        default_factory=lambda: defaultdict(list)
    )
    truths: dict[Stamp, Any] = field(default_factory=dict)
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    weights: dict[str, dict[str, str]] = field(default_factory=dict)

    def prediction_arrays(self, stamp: Stamp, seed: int) -> tuple[Cloud, NDArray[np.float32]]:
        """(N, 3) points and (S, N, 3) flows recorded for a cloud and a seed.

        Raises:
            BagError: they were not recorded.
        """
        found = [p for p in self.predictions.get((stamp, seed), []) if p.ok]
        if not found:
            raise BagError(f"the recording has no {PREDICTION} for stamp {stamp}, seed {seed}")
        return clouds.from_flow_message(found[-1].flows)


def read_story(bag: Bag, span: Span | None = None) -> Story:
    """Read a recording's story.

    Raises:
        BagError: the parameters in it cannot be read, or a message is damaged.
    """
    story = Story()
    ours = "flowbothd_interfaces"
    takers: dict[tuple[str, str], Callable[[Any], None]] = {
        (EVENTS, f"{ours}/msg/PolicyEvent"): story.events.append,
        (DECISIONS, f"{ours}/msg/PolicyDecision"): story.decisions.append,
        (CLOUD, "sensor_msgs/msg/PointCloud2"): lambda m: story.clouds.update(
            {key(m.header.stamp): _points(m)}
        ),
        (PREDICTION, f"{ours}/msg/FlowPrediction"): lambda m: story.predictions[
            key(m.header.stamp), m.seed
        ].append(m),
        (TRUTH, f"{ours}/srv/GroundTruthFlow_Event"): lambda m: _take_truth(story, m),
    }
    found = {topic_called(bag, *which): taker for which, taker in takers.items()}
    names: dict[str, Callable[[Any], None]] = {t: f for t, f in found.items() if t is not None}
    for message in bag.messages(names, span):
        names[message.topic](decoded(bag, message))
    # Two threads of the recorder's middleware may have swapped neighbours; the numbers say how.
    story.events.sort(key=lambda m: m.sequence)
    story.parameters = stored_parameters(bag)
    story.weights = stored_weights(bag)
    return story


def oracle_parameters(parameters: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the parameters of the oracle that predicted; None if a network did.

    In recordings made before oracle_node existed, inference_node's parameter `predictor` says so.
    """
    if ORACLE_NODE in parameters:
        return parameters[ORACLE_NODE]
    inference = parameters.get(INFERENCE_NODE, {})
    return inference if inference.get("predictor") in ORACLES else None


def predictor_name(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return which predictor a graph had: an oracle by its name, ``model``, or ``unknown``."""
    oracle = oracle_parameters(parameters)
    if oracle is not None:
        return str(oracle["predictor"])
    return "model" if INFERENCE_NODE in parameters else "unknown"


def _points(message: Any) -> Cloud:
    return np.ascontiguousarray(clouds.from_cloud_message(message, clouds.XYZ).reshape(-1, 3))


def _take_truth(story: Story, message: Any) -> None:
    for response in message.response:
        story.truths[key(response.flows.header.stamp)] = response
