"""Quality of service of our topics, named in one place."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _profile(depth: int, *, reliable: bool = True, latched: bool = False) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


STATE = _profile(50)
"""Joint states, suction and simulation state: reliable, short queue."""

STATE_NEWEST = _profile(50, reliable=False)
"""Subscribing to states of which any one may be missed: a lost one must not hold up the next,
which a reliable reader waits with until the lost one has been sent again, a second or more."""

SENSOR = _profile(5, reliable=False)
"""Subscribing to sensors of others: best effort also matches reliable publishers."""

IMAGE = _profile(1)
"""Publishing and subscribing images and clouds: newest wins."""

FRAMES = _profile(8)
"""A camera at full rate: a hiccup of a quarter of a second loses nothing."""

FRAMES_BEST_EFFORT = _profile(8, reliable=False)
"""The same, for drivers that publish as best effort: they offer nothing to a reliable reader."""

COMMAND = _profile(10)
"""Trajectories and suction commands."""

EVENT = _profile(200)
"""Results, predictions and policy events: none may be lost to a slow reader."""

STORY = _profile(200, latched=True)
"""Policy inputs: a recorder that starts with the graph must not miss the first ones."""

LATCHED = _profile(1, latched=True)
"""Robot description: late joiners get the last one."""

HEARTBEAT = _profile(5)
"""Signs of life."""
