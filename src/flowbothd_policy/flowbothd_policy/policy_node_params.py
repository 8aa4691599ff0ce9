"""Parameters of the policy node: the policy's own, and how it is run as a node."""

from __future__ import annotations

from dataclasses import dataclass

from flowbothd_common.parameters import parameter
from flowbothd_policy.params import PolicyParams


@dataclass(frozen=True)
class PolicyNodeParams(PolicyParams):
    """Parameters of the policy, and the nodes that it relies on."""

    base_frame: str = parameter("panda_link0", "frame of clouds, goals and decisions")
    autostart: bool = parameter(False, "start a run as soon as everything is there")
    watch_nodes: tuple[str, ...] = parameter(
        ("perception_node", "inference_node", "motion_node", "suction_node"),
        "nodes whose heartbeats the run depends on",
    )
    watch_timeout: float = parameter(
        0.7, "silence after which a node is missing, steady clock [s]", minimum=0.1, maximum=60.0
    )
    service_timeout: float = parameter(
        3.0, "wait for answers of suction and stop services [s]", minimum=0.1, maximum=60.0
    )
