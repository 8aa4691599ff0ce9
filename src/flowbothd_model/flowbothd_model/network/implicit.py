"""One step from a small random vector to a flow, trained so that some vector gives every answer.

Conditional implicit maximum likelihood (Li et al. 2020; Rupprecht et al. 2017 for the relaxed
choice): for every cloud several vectors are drawn, and the network learns from the one whose flow
comes nearest to the truth. Every answer in the data is thus near some vector's flow, which is what
the winner-take-all error asks for. Now and then the first vector learns instead of the best, so
that none is left to give nonsense; with a history that says what is moving, mostly so.
"""

from __future__ import annotations

import torch
from torch import Tensor

from flowbothd_model.network.network import FlowNetwork, HistoryBatch

_ANY = 0.05
_ANY_TOLD = 0.7
_SHORT = 0.1  # below this length the angle counts less: its gradient would have no bound
LEVEL = 100.0
"""The level that stands for "nothing is known of the flow yet"."""


def relative_error(prediction: Tensor, flow: Tensor, angle_weight: float) -> Tensor:
    """(B,) squared error relative to the flow there is, and angle, of (B, N, 3) flows."""
    size = flow.square().sum(-1).mean(1) + 0.03
    error = (prediction - flow).square().sum(-1).mean(1) / size
    moving = (flow.norm(dim=-1) > 1e-3).to(flow.dtype)
    cosine = torch.nn.functional.cosine_similarity(prediction, flow, dim=-1, eps=_SHORT)
    angle = (moving * (1 - cosine)).sum(1) / moving.sum(1).clamp(min=1)
    total: Tensor = error + angle_weight * angle
    return total


def spread_vectors(batch: int, hypotheses: int, latent: int, generator: torch.Generator) -> Tensor:
    """(batch, hypotheses, latent) normal vectors whose signs differ within a cloud.

    Every one is standard normal on its own. The first three signs run through their eight
    combinations in random order, so that an answer that lives in one octant is seldom missed;
    every miss teaches some other vector a wrong answer, and makes all of them timid.
    """
    vectors = torch.randn((batch, hypotheses, latent), generator=generator)
    order = torch.rand((batch, -(-hypotheses // 8), 8), generator=generator).argsort(-1)
    octant = order.flatten(1)[:, :hypotheses]  # (batch, hypotheses)
    for bit in range(min(3, latent)):
        sign = 1.0 - 2.0 * ((octant >> bit) & 1)
        vectors[..., bit] = vectors[..., bit].abs() * sign
    return vectors


def implicit_prediction(
    network: FlowNetwork,
    points: Tensor,
    history: HistoryBatch | None,
    told: Tensor,
    flow: Tensor,
    latent: int,
    hypotheses: int,
    angle_weight: float,
    generator: torch.Generator,
) -> Tensor:
    """(B, N, 3) prediction of the vector that is to learn, for each cloud.

    Args:
        network: With a latent input.
        points: (B, N, 3) in the model's frame.
        history: Likewise.
        told: (B,) bool, whether the history says what is moving.
        flow: (B, N, 3) truth.
        latent: Size of the vectors.
        hypotheses: Vectors tried per cloud.
        angle_weight: Of the error by which they are compared.
        generator: Of the vectors, on the CPU.
    """
    batch = len(points)
    vectors = spread_vectors(batch, hypotheses, latent, generator).to(points.device)
    lucky = torch.rand((batch,), generator=generator).to(points.device)
    context = network.encode(points, history)
    level = torch.full((batch * hypotheses,), LEVEL, device=points.device)
    with torch.no_grad():
        tried = network.denoise(context, vectors.flatten(0, 1), level)
        error = relative_error(
            tried.float(), flow.repeat_interleave(hypotheses, 0), angle_weight
        ).view(batch, hypotheses)
    anyone = lucky < torch.where(told, _ANY_TOLD, _ANY)
    chosen = torch.where(anyone, 0, error.argmin(1))
    picked = vectors[torch.arange(batch, device=points.device), chosen]
    return network.denoise(context, picked, level[:batch])
