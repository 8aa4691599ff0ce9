"""From an encoded cloud to max-normalised flows."""

from __future__ import annotations

import torch
from torch import Tensor

from flowbothd_model.config import ModelConfig
from flowbothd_model.frames import into_frame, max_normalised
from flowbothd_model.network.diffusion import Diffusion
from flowbothd_model.network.implicit import LEVEL
from flowbothd_model.network.network import Context, FlowNetwork, HistoryBatch

SAMPLERS = {"ddpm": 1.0, "ddim": 0.0}
"""Name -> share of fresh noise per step."""


def encode_batch(
    network: FlowNetwork,
    config: ModelConfig,
    points: Tensor,
    history_points: Tensor | None,
    history_flow: Tensor | None,
    present: Tensor,
) -> Context:
    """Bring clouds into the model's frame and encode them."""
    moved, moved_history = into_frame(config.frame, points, history_points)
    history = None
    if moved_history is not None and history_flow is not None and bool(present.any()):
        history = HistoryBatch(moved_history, history_flow, present)
    return network.encode(moved, history if config.network.history else None)


def sample_flows(
    network: FlowNetwork,
    config: ModelConfig,
    context: Context,
    samples: int,
    seed: int,
    sampler: str | None = None,
    steps: int | None = None,
) -> Tensor:
    """(C * samples, N, 3) max-normalised flows of the C clouds in `context`, in a row.

    Raises:
        ValueError: unknown sampler, or steps out of range.
    """
    name = sampler or config.sampler
    if name not in SAMPLERS:
        raise ValueError(f"sampler must be one of {sorted(SAMPLERS)}, got {name!r}")
    generator = torch.Generator().manual_seed(seed)
    count, device, rows = network.points_of(context), context.device, context.clouds * samples
    chosen = config.sampling_steps if steps is None else steps
    if config.network.latent:
        if chosen != 1:
            raise ValueError(f"a model without a chain has 1 step, got {chosen}")
        vectors = torch.randn((rows, config.network.latent), generator=generator)
        level = torch.full((rows,), LEVEL, device=device)
        return max_normalised(network.denoise(context, vectors.to(device), level))
    repeated = context.repeated(samples)
    if not config.network.diffusion:
        level = torch.ones(rows, device=device)
        flow = network.denoise(repeated, torch.zeros(rows, count, 3, device=device), level)
        return max_normalised(flow)
    diffusion = Diffusion(config.diffusion)
    noise = torch.randn((rows, count, 3), generator=generator).to(device)

    def denoise(noisy: Tensor, level: Tensor) -> Tensor:
        return network.denoise(repeated, noisy, level.to(noisy.dtype) * config.diffusion.steps)

    return max_normalised(diffusion.sample(denoise, noise, chosen, SAMPLERS[name], generator))
