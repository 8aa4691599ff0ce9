"""Names by which older recordings know topics, message types and parameters.

Only names have changed, never the order or the type of a field. CDR carries no names, so that the
messages of such a recording are those of the new types, byte for byte.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from flowbothd_rosbag.metadata import Topic

_OURS = "flowbothd_interfaces/"

TOPICS = {
    "policy/events": "policy/decisions",
    "policy/inputs": "policy/events",
    "motion/release/_service_event": "motion/clear_stop/_service_event",
}
"""End of an old topic's name -> of the new one."""

TYPES = {
    _OURS + "msg/PolicyEvent": _OURS + "msg/PolicyDecision",
    _OURS + "msg/PolicyInput": _OURS + "msg/PolicyEvent",
    _OURS + "msg/JointArc": _OURS + "msg/JointEstimate",
}
"""Old message type -> new one."""

_GONE = {old for old in TYPES if old not in TYPES.values()}
"""Types that no newer recording has."""

_OLD_EVENT = "RIHS01_a83341ea3e61fb131f6d9a59412248ca885be749fe5e22ec05be62fb0b504a41"
"""Hash of PolicyEvent while that was the name of a decision: the name alone does not tell."""

PARAMETERS = {
    "perception_node": {
        "joint_reach": "max_extrapolation",
        "joint_still": "stationary_threshold",
        "joint_gap": "max_gap",
        "outliers.support": "outliers.min_depth_neighbors",
        "outliers.deviations": "outliers.std_ratio",
        "outliers.neighbours": "outliers.nb_neighbors",
        "outliers.cluster": "outliers.cluster_tolerance",
    },
    "motion_node": {
        "planning.least_push": "planning.min_push_fraction",
        "planning.continuation": "planning.lookahead",
        "safety.slow_conditioning": "safety.slow_singular_value",
    },
    "policy_node": {
        "peers": "watch_nodes",
        "peer_timeout": "watch_timeout",
        "give_arc": "send_joint_estimate",
    },
}
"""Node -> old name of a parameter -> new one."""

VALUES = {("arm_node", "backend"): {"recording": "mock"}}
VALUES["pump_node", "backend"] = VALUES["arm_node", "backend"]
"""Node and parameter -> old value -> new one."""


def current_topics(stored: Iterable[Topic]) -> dict[str, Topic]:
    """Return the topics of a recording by their names in it, with the names of today.

    Nothing is changed unless one of the topics shows that the recording is older than the names:
    ``policy/events`` has another meaning in newer ones.
    """
    topics = {topic.name: topic for topic in stored}
    if not any(t.type in _GONE or t.type_hash == _OLD_EVENT for t in topics.values()):
        return topics
    return {name: _current(topic) for name, topic in topics.items()}


def _current(topic: Topic) -> Topic:
    for old, new in TOPICS.items():
        if topic.name.endswith("/" + old):
            topic = replace(topic, name=topic.name.removesuffix(old) + new)
            break
    if topic.type in TYPES:
        # The hash is one of the names too.
        topic = replace(topic, type=TYPES[topic.type], type_hash="")
    return topic


def current_parameters(node: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a node's recorded parameters with the names and values of today.

    Args:
        node: Its name, with or without a namespace.
        values: Dotted parameter name -> value, as recorded.
    """
    base = node.rsplit("/", maxsplit=1)[-1]
    names = PARAMETERS.get(base, {})
    result = {}
    for old, value in values.items():
        name = names.get(old, old)
        known = VALUES.get((base, name), {})
        result[name] = known.get(value, value) if isinstance(value, str) else value
    return result
