"""One training loss: frame, noise, network, error. Chance comes from seed and step."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from flowbothd_model.config import ModelConfig
from flowbothd_model.data.stream import Batch
from flowbothd_model.diffusion import Diffusion
from flowbothd_model.frames import into_frame
from flowbothd_model.network import HistoryBatch

Forward = Callable[[Tensor, HistoryBatch | None, Tensor, Tensor], Tensor]


def step_generator(seed: int, step: int, rank: int = 0) -> torch.Generator:
    """The source of levels and noise of one step; nothing has to be saved to resume."""
    return torch.Generator().manual_seed((seed * 1_000_003 + step) * 1009 + rank)


def training_loss(
    forward: Forward,
    config: ModelConfig,
    batch: Batch,
    generator: torch.Generator,
    draws: int = 1,
) -> Tensor:
    """Mean loss of a batch.

    Args:
        forward: The network.
        config: Of the model.
        batch: On the network's device.
        generator: On the CPU, for levels and noise.
        draws: Levels and noises per cloud; the cloud is encoded once for all of them.
    """
    diffusion = Diffusion(config.diffusion)
    device = batch.points.device
    points, history_points = into_frame(config.frame, batch.points, batch.history_points)
    history = None
    if config.network.history and history_points is not None:
        history = HistoryBatch(history_points, batch.history_flow, batch.has_history)
    if not config.network.diffusion:
        level = torch.ones(len(points), device=device)
        prediction = forward(points, history, torch.zeros_like(points), level)
        return (prediction - batch.flow).square().sum(-1).mean()
    flow = batch.flow.repeat_interleave(draws, 0)
    level = diffusion.random_levels(len(flow), generator).to(device)
    noise = torch.randn(flow.shape, generator=generator).to(device)
    noisy = diffusion.noised(flow, noise, level)
    # The schedule counts in steps, as published; the embedding expects that order of magnitude.
    prediction = forward(points, history, noisy, level * config.diffusion.steps)
    return diffusion.loss(prediction.float(), flow, noise, level)
