"""Histories as a run makes them: what the network itself said of the observation before.

In training the history's flow is the truth. In a run it is a sample that was pulled along and that
moved the part: of the right side, but blurred in its lengths, and now and then of a mode that
is not the part's. Trained on the truth alone, the network repeats such faults pull after pull. So a
share of the histories is replaced by a sample of the network as it stands (scheduled sampling,
Bengio et al. 2015), if pulling along it would have moved the part; otherwise the run would
not have remembered it.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as fn

from flowbothd_model.config import ModelConfig
from flowbothd_model.metrics import field_cosine
from flowbothd_model.network.network import FlowNetwork
from flowbothd_model.network.sampler import encode_batch, sample_flows

_TELLING = 0.7
_STEPS = 8  # of a chain; short, because it is paid for in every step of the training


def with_own_histories(
    network: FlowNetwork,
    config: ModelConfig,
    points: Tensor,
    flow: Tensor,
    share: float,
    generator: torch.Generator,
) -> tuple[Tensor, Tensor]:
    """Flow of the histories, a `share` of them the network's own; no gradients.

    Args:
        network: As it stands.
        config: Of the model.
        points: (B, M, 3) clouds of the histories [m].
        flow: (B, M, 3) their true flow, max-normalised.
        share: Of the histories for which the network is asked, 0 to 1.
        generator: Of samples and choice, on the CPU.

    Returns:
        (B, M, 3) flow, and (B,) whether it tells the part's motion: with one that does not, several
        answers have to stay open.
    """
    asked = (torch.rand((len(points),), generator=generator) < share).to(points.device)
    seed = int(torch.randint(2**31, (1,), generator=generator))
    steps = min(config.sampling_steps, _STEPS)
    before = network.training
    network.eval()  # what a run asks; and the averages of normalisation layers stay as they are
    with torch.no_grad():
        absent = torch.zeros_like(asked)
        context = encode_batch(network, config, points, None, None, absent)
        own = sample_flows(network, config, context, 1, seed, "ddim", steps).float()
        network.train(before)
        given = torch.where((asked & would_move(own, flow))[:, None, None], own, flow)
        return given, field_cosine(given, flow) > _TELLING


def would_move(predicted: Tensor, flow: Tensor) -> Tensor:
    """(B,) whether a pull along (B, N, 3) `predicted` moves what truly moves along `flow`.

    Pulled is that point of the moving parts which is said to move most; it moves if its own way is
    less than a right angle from the pull.
    """
    moving = flow.norm(dim=-1) > 1e-3  # (B, N)
    grasped = torch.where(moving, predicted.norm(dim=-1), -1.0).argmax(1)  # (B,)
    row = torch.arange(len(flow), device=flow.device)
    along = fn.cosine_similarity(predicted[row, grasped], flow[row, grasped], dim=-1)
    moved: Tensor = (along > 0) & moving[row, grasped]
    return moved
