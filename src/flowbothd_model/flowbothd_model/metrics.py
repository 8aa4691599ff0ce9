"""Errors of predicted flows, as the FlowBotHD code defines them, over many samples of one cloud."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from flowbothd_model.frames import max_normalised

RIGHT_ERROR, WRONG_ERROR = 0.2, 0.6
"""The paper's multi-modality rule: some sample below the first, some above the second."""


@dataclass(frozen=True)
class FlowErrors:
    """Errors of S samples against one truth, over the points that move.

    Attributes:
        cosine: (S,) mean cosine of the directions.
        mean_error: (S,) mean error norm, what the reference calls "rmse".
        rmse: (S,) root mean square error norm.
        magnitude: (S,) mean difference of the lengths, absolute.
        squared: (S,) mean squared error over all points, by which the winner is chosen.
        field: (S,) cosine of the whole fields as vectors of 3 N numbers. It alone distinguishes a
            closed door's left hinge from its right one: every point begins to move the same way.
    """

    cosine: Tensor
    mean_error: Tensor
    rmse: Tensor
    magnitude: Tensor
    squared: Tensor
    field: Tensor

    @property
    def winner(self) -> int:
        """The sample with the least squared error over all points."""
        return int(self.squared.argmin())

    @property
    def multimodal(self) -> bool:
        """The paper's rule: right and wrong samples both occur."""
        return bool((self.mean_error < RIGHT_ERROR).any() and (self.mean_error > WRONG_ERROR).any())

    @property
    def wrong_share(self) -> float:
        """Share of samples whose mean cosine is negative: they pull against the opening."""
        return float((self.cosine < 0).float().mean())


def flow_errors(samples: Tensor, truth: Tensor) -> FlowErrors:
    """Compare (S, N, 3) samples with the (N, 3) truth, both max-normalised first.

    Raises:
        ValueError: nothing moves in the truth.
    """
    predicted, target = max_normalised(samples), max_normalised(truth)
    moving = target.norm(dim=-1) > 1e-6
    if not bool(moving.any()):
        raise ValueError("no point moves in the ground truth, so that errors are undefined")
    squared = (predicted - target).square().sum(-1)  # (S, N)
    norm = squared[:, moving].sqrt()
    cosine = torch.nn.functional.cosine_similarity(
        predicted, target.expand_as(predicted), dim=-1, eps=1e-8
    )
    lengths = (predicted.norm(dim=-1) - target.norm(dim=-1)).abs()
    return FlowErrors(
        cosine[:, moving].mean(1),
        norm.mean(1),
        norm.square().mean(1).sqrt(),
        lengths[:, moving].mean(1),
        squared.mean(1),
        field_cosine(predicted, target[None]),
    )


def field_cosine(fields: Tensor, others: Tensor) -> Tensor:
    """(S,) cosine of (S, N, 3) whole fields with others; a left and a right hinge agree by 0.5."""
    return torch.nn.functional.cosine_similarity(
        fields.flatten(1), others.flatten(1), dim=-1, eps=1e-8
    )
