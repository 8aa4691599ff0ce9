"""Training samples: closed, open, open with history, drawn as in the paper."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import torch

from flowbothd_common.transforms import unit
from flowbothd_common.types import Array
from flowbothd_model.data.articulated import ArticulatedObject, axis_rotation
from flowbothd_model.data.camera import View, ViewPreset, paper_view, robot_view
from flowbothd_model.data.observation import Observation, observe, turned


class Situation(StrEnum):
    """State of the object and knowledge about it; the paper trains on one third each."""

    CLOSED = "closed"
    OPEN = "open"
    HISTORY = "open_with_history"


@dataclass(frozen=True)
class Sample:
    """One training sample.

    Attributes:
        current: What is to be predicted.
        history: The previous observation with its truth; only with Situation.HISTORY.
        category: Of the object.
        name: Of the object.
        situation: How it was drawn.
    """

    current: Observation
    history: Observation | None
    category: str
    name: str
    situation: Situation


@dataclass(frozen=True)
class SampleConfig:
    """Distribution of the samples.

    Attributes:
        points: Points per cloud.
        robot_share: Share of views by a robot's camera; the rest as published.
        arm_share: Share of the robot's views in which its arm may hide part of the object.
        table_share: Share of them in which what is near the table is lost with it.
        history_tilt: Standard deviation of an angle by which the history's flow is off [rad]: in a
            run it is what the network predicted, not the truth.
        augment: Turn about z by any angle, and mirror half of the samples.
        single_share: Share of opened objects where only the target joint is open, as in a run of
            the policy; otherwise all joints open independently.
        from_closed_share: Share of histories that begin with everything closed.
        min_step: Smallest motion between history and current, as a share of the joint's range.
        max_step: Largest such motion.
    """

    points: int = 1024
    robot_share: float = 0.5
    arm_share: float = 0.4
    table_share: float = 0.6
    history_tilt: float = 0.15
    augment: bool = True
    single_share: float = 0.5
    from_closed_share: float = 0.3
    min_step: float = 0.02
    max_step: float = 0.7

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.points < 256:
            raise ValueError(f"points must be at least 256, got {self.points}")
        if not 0.0 < self.min_step <= self.max_step <= 1.0:
            raise ValueError(
                f"0 < min_step <= max_step <= 1 must hold, got {self.min_step}, {self.max_step}"
            )


def draw_sample(
    item: ArticulatedObject,
    situation: Situation,
    config: SampleConfig,
    rng: np.random.Generator,
    device: torch.device | str = "cpu",
    attempts: int = 6,
) -> Sample | None:
    """Draw one sample of `item`; None if no view shows a moving part in `attempts` attempts."""
    for _ in range(attempts):
        before, now = _positions(item, situation, config, rng)
        view = _view(item, now, config, rng)
        current = observe(item, now, view, config.points, rng, device)
        if current is None:
            continue
        history = None
        if before is not None:
            history = observe(item, before, view, config.points, rng, device)
            if history is None:
                continue
            history = _tilted(history, float(rng.normal(0.0, config.history_tilt)), rng)
        if config.augment:
            yaw, mirror = float(rng.uniform(-np.pi, np.pi)), bool(rng.random() < 0.5)
            current = turned(current, yaw, mirror)
            history = turned(history, yaw, mirror) if history is not None else None
        return Sample(current, history, item.category, item.name, situation)
    return None


def _tilted(seen: Observation, angle: float, rng: np.random.Generator) -> Observation:
    """The observation with its flow turned about a random axis, everywhere alike."""
    turn = axis_rotation(unit(rng.normal(size=3)), angle).astype(np.float32)
    return replace(seen, flow=seen.flow @ turn.T)


def _positions(
    item: ArticulatedObject, situation: Situation, config: SampleConfig, rng: np.random.Generator
) -> tuple[Array | None, Array]:
    """Joint positions of the history (or None) and of the current observation."""
    closed = item.closed()
    if situation is Situation.CLOSED:
        return None, closed
    movable = item.movable
    target = int(rng.choice(movable))
    joint = item.joints[target]
    span = joint.upper - joint.lower
    start = closed.copy()
    chosen = [target] if rng.random() < config.single_share else movable
    for index in chosen:
        other = item.joints[index]
        start[index] = other.lower + rng.random() * (other.upper - other.lower)
    if situation is Situation.OPEN:
        return None, start
    if rng.random() < config.from_closed_share:
        start[target] = joint.lower
    step = rng.uniform(config.min_step, config.max_step) * span
    start[target] = min(start[target], joint.upper - config.min_step * span)
    now = start.copy()
    now[target] = min(start[target] + step, joint.upper)
    return start, now


def _view(
    item: ArticulatedObject, positions: Array, config: SampleConfig, rng: np.random.Generator
) -> View:
    """A view by one of the presets; the object is seen standing on z = 0."""
    preset = ViewPreset.ROBOT if rng.random() < config.robot_share else ViewPreset.PAPER
    vertices = item.posed_vertices(positions)
    low, high = vertices.min(0).astype(float), vertices.max(0).astype(float)
    if preset is ViewPreset.ROBOT:
        return robot_view(rng, low, high, config.arm_share, config.table_share)
    view = paper_view(rng)
    lift = np.eye(4)
    lift[2, 3] = -low[2]
    return View(view.T_camera_object @ lift, view.width, view.height, view.focal)
