"""The noise process, its loss and its samplers, in one notation: noisy = a * flow + s * noise.

Two schedules. `ddpm_linear` is the published one: 100 steps, beta from 0.001 to 0.2, a network that
predicts the noise (Ho et al. 2020). `straight` mixes linearly, a = 1 - t and s = t, with a network
that predicts the flow; its levels are moved towards noise, where the modes part.

Learned variance: the published code lets the network put out variances too and trains them with
an unscaled variational bound whose last term is meant for images. The paper does not mention it,
and we do not train it: `ddpm` samples with the posterior's variance, which the schedule gives. The
three output channels are there, so that the network has the published shape, and go unused.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from flowbothd_model.config import DiffusionConfig, Schedule, Target

_SHORT = 0.1
"""Length below which the angle no longer counts in full; its gradient would have no bound."""

_SMALL = 0.03
"""Mean squared flow of a cloud below which its weight in the loss no longer grows."""

Denoise = Callable[[Tensor, Tensor], Tensor]
"""(noisy (B, N, 3), level (B,)) -> (B, N, 3) in the terms of the configured target."""


@dataclass(frozen=True)
class Mix:
    """Shares of signal and noise at some levels.

    Attributes:
        signal: Of the shape of the levels.
        noise: Likewise.
    """

    signal: Tensor
    noise: Tensor


class Diffusion:
    """A configured noise process."""

    def __init__(self, config: DiffusionConfig) -> None:
        self.config = config
        scale = 100.0 / config.steps
        beta = torch.linspace(
            0.001 * scale, min(0.2 * scale, 0.999), config.steps, dtype=torch.float64
        )
        self._alpha_bar = torch.cat((torch.ones(1, dtype=torch.float64), (1 - beta).cumprod(0)))

    def mix(self, level: Tensor, points: int) -> Mix:
        """Shares at `level` in [0, 1], 0 = no noise, for clouds of so many points."""
        if self.config.schedule is Schedule.DDPM_LINEAR:
            index = (level * self.config.steps).round().long()
            bar = self._alpha_bar.to(level.device)[index]
            return Mix(bar.sqrt().to(level.dtype), (1 - bar).sqrt().to(level.dtype))
        shift = self.config.shift
        time = shift * level / (1 + (shift - 1) * level)
        density = (
            math.sqrt(points / self.config.reference_points)
            if self.config.reference_points
            else 1.0
        )
        return Mix(1 - time, time * density)

    def random_levels(self, count: int, generator: torch.Generator | None) -> Tensor:
        """(count,) levels to train at: the chain's steps, or uniform."""
        if self.config.schedule is Schedule.DDPM_LINEAR:
            steps = torch.randint(1, self.config.steps + 1, (count,), generator=generator)
            return steps.float() / self.config.steps
        # Evenly spread over the batch, which makes the loss less noisy.
        offset = torch.rand((1,), generator=generator)
        order = torch.randperm(count, generator=generator)
        return ((order + offset) / count).clamp(1e-3, 1.0)

    def loss(self, prediction: Tensor, flow: Tensor, noise: Tensor, level: Tensor) -> Tensor:
        """Mean squared error of the target; for flows also of direction, where noise is low.

        Args:
            prediction: (B, N, 3) of the network.
            flow: (B, N, 3) truth.
            noise: (B, N, 3) that was added.
            level: (B,).
        """
        if self.config.target is Target.EPSILON:
            return (prediction - noise).square().mean()
        # Relative to the flow there is, so that clouds with a small moving part count as well.
        size = flow.square().sum(-1).mean(1) + _SMALL
        loss = ((prediction - flow).square().sum(-1).mean(1) / size).mean()
        if self.config.angle_weight:
            moving = flow.norm(dim=-1) > 1e-3
            cosine = torch.nn.functional.cosine_similarity(prediction, flow, dim=-1, eps=_SHORT)
            share = self.mix(level, flow.shape[1]).signal[:, None] * moving
            loss = loss + self.config.angle_weight * (
                share * (1 - cosine)
            ).sum() / moving.sum().clamp(min=1)
        return loss

    def noised(self, flow: Tensor, noise: Tensor, level: Tensor) -> Tensor:
        """(B, N, 3) flow with noise at (B,) levels."""
        mix = self.mix(level, flow.shape[1])
        return mix.signal[:, None, None] * flow + mix.noise[:, None, None] * noise

    def sample(
        self, denoise: Denoise, noise: Tensor, steps: int, eta: float, generator: torch.Generator
    ) -> Tensor:
        """(B, N, 3) samples from the first (B, N, 3) standard normal `noise`.

        Args:
            denoise: The network.
            noise: Where the chain starts.
            steps: Evaluations of the network, evenly spaced in level.
            eta: Fresh noise per step: 1 = ancestral (`ddpm`), 0 = none (`ddim`).
            generator: Of the fresh noise.

        Raises:
            ValueError: `steps` is not in 1..config.steps.
        """
        if not 1 <= steps <= self.config.steps:
            raise ValueError(f"steps must be in 1..{self.config.steps}, got {steps}")
        points = noise.shape[1]
        levels = torch.linspace(1.0, 0.0, steps + 1, dtype=torch.float64)
        if self.config.schedule is Schedule.DDPM_LINEAR:
            levels = (levels * self.config.steps).round() / self.config.steps
        shares = [self.mix(level, points) for level in levels]
        current = noise * float(shares[0].noise)
        flow = current
        for here, after, level in zip(shares[:-1], shares[1:], levels[:-1], strict=True):
            a, s = float(here.signal), float(here.noise)
            a2, s2 = float(after.signal), float(after.noise)
            predicted = denoise(
                current, torch.full((len(noise),), float(level), device=noise.device)
            )
            if self.config.target is Target.EPSILON:
                estimate, flow = predicted, (current - s * predicted) / a
            else:
                estimate, flow = (current - a * predicted) / s, predicted
            if s2 == 0.0:
                return flow
            # Variance of the posterior q(x_after | x_here, flow), as a share of eta squared.
            ratio = (a / a2) * (s2 / s)
            fresh = eta * s2 * math.sqrt(max(0.0, 1.0 - ratio * ratio))
            current = a2 * flow + math.sqrt(max(0.0, s2 * s2 - fresh * fresh)) * estimate
            if fresh:
                extra = torch.randn(noise.shape, generator=generator, dtype=noise.dtype)
                current = current + fresh * extra.to(noise.device)
        return flow
