"""PointNet++ parts of the published network: set abstraction, feature propagation, history encoder.

Qi et al., PointNet++ (2017); sizes and conventions as measured on the FlowBotHD code: normalisation
after the activation, nothing after the last layer of an MLP, sums over at most 64 neighbours.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from flowbothd_model.network.geometry import (
    ball,
    farthest_points,
    gather,
    interpolate,
    interpolation,
)

_CAP = 64
_SHARES = (0.2, 0.25)
_RADII = (0.2, 0.4)


class PointMlp(nn.Module):
    """Linear layers; all but the last are followed by LeakyReLU(0.01), then batch norm.

    Args:
        sizes: Channels, from the input to the output.
        rectify: A ReLU after the last layer, as in the history encoder.
    """

    def __init__(self, sizes: Sequence[int], rectify: bool = False) -> None:
        super().__init__()
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(sizes))
        self.norms = nn.ModuleList(nn.BatchNorm1d(size) for size in sizes[1:-1])
        self.rectify = rectify

    def forward(self, x: Tensor) -> Tensor:
        """(..., C_in) -> (..., C_out); statistics over all leading dimensions."""
        shape = x.shape[:-1]
        x = x.reshape(-1, x.shape[-1])
        if not self.training and not torch.is_grad_enabled():
            return self._folded(x).view(*shape, -1)
        for layer, norm in zip(self.layers[:-1], self.norms, strict=True):
            x = norm(fn.leaky_relu(layer(x), 0.01))
        x = self.layers[-1](x)
        if self.rectify:
            x = fn.relu(x)
        return x.view(*shape, -1)

    def _folded(self, x: Tensor) -> Tensor:
        """The same for fixed statistics: each norm is affine, so the next layer can do its work."""
        layers = [cast(nn.Linear, layer) for layer in self.layers]
        norms = [cast(nn.BatchNorm1d, norm) for norm in self.norms]
        x = layers[0](x)
        for norm, layer in zip(norms, layers[1:], strict=True):
            scale = norm.weight * (cast(Tensor, norm.running_var) + norm.eps).rsqrt()
            shift = norm.bias - cast(Tensor, norm.running_mean) * scale
            bias = layer.bias + layer.weight @ shift
            x = fn.linear(fn.leaky_relu_(x, 0.01), layer.weight * scale, bias)
        return fn.relu_(x) if self.rectify else x


@dataclass(frozen=True)
class Level:
    """One set abstraction's geometry.

    Attributes:
        centres: (B, M, 3) chosen points.
        index: (B, M, 64) neighbours among the points of the level below.
        valid: (B, M, 64) bool; the rest repeats the first neighbour.
        offset: (B, M, 64, 3) from the centre to the neighbour.
    """

    centres: Tensor
    index: Tensor
    valid: Tensor
    offset: Tensor


@dataclass(frozen=True)
class CloudGeometry:
    """Everything about a cloud that no feature changes.

    Attributes:
        levels: The two set abstractions.
        up2: Weights and indices (k = 3) from the second to the first level.
        up1: Likewise from the first level to the points.
    """

    levels: tuple[Level, Level]
    up2: tuple[Tensor, Tensor]
    up1: tuple[Tensor, Tensor]


def cloud_geometry(points: Tensor) -> CloudGeometry:
    """Farthest points, balls and interpolation weights of (B, N, 3) points."""
    levels, below = [], points
    for share, radius in zip(_SHARES, _RADII, strict=True):
        count = max(1, -int(-below.shape[1] * share // 1))
        centres = gather(below, farthest_points(below, count))
        index, valid = ball(centres, below, radius, _CAP)
        offset = gather(below, index) - centres.unsqueeze(2)
        levels.append(Level(centres, index, valid, offset))
        below = centres
    first, second = levels
    return CloudGeometry(
        (first, second),
        interpolation(first.centres, second.centres, 3),
        interpolation(points, first.centres, 3),
    )


class SetAbstraction(nn.Module):
    """Messages (feature and offset of each neighbour) through an MLP, then their maximum."""

    def __init__(self, sizes: Sequence[int], rectify: bool = False) -> None:
        super().__init__()
        self.mlp = PointMlp(sizes, rectify)

    def forward(self, features: Tensor, level: Level) -> Tensor:
        """(B, N, C) -> (B, M, C_out)."""
        messages = torch.cat((gather(features, level.index), level.offset), dim=-1)
        if not self.training:
            # Padding repeats a neighbour, which changes no maximum.
            return self.mlp(messages).amax(2)  # type: ignore[no-any-return]
        # Padding must not enter the batch statistics.
        answers = self.mlp(messages[level.valid])
        padded = answers.new_full((*level.valid.shape, answers.shape[-1]), -torch.inf)
        padded[level.valid] = answers
        return cast(Tensor, padded.amax(2))


class GlobalAbstraction(nn.Module):
    """All centres with their absolute positions through an MLP, then the maximum."""

    def __init__(self, sizes: Sequence[int], rectify: bool = False) -> None:
        super().__init__()
        self.mlp = PointMlp(sizes, rectify)

    def forward(self, features: Tensor, centres: Tensor) -> Tensor:
        """(B, M, C), (B, M, 3) -> (B, C_out)."""
        return self.mlp(torch.cat((features, centres), dim=-1)).amax(1)  # type: ignore[no-any-return]


class FeaturePropagation(nn.Module):
    """Features of a coarse level, interpolated and joined with those of the fine level."""

    def __init__(self, sizes: Sequence[int]) -> None:
        super().__init__()
        self.mlp = PointMlp(sizes)

    def forward(self, coarse: Tensor, skip: Tensor, up: tuple[Tensor, Tensor] | None) -> Tensor:
        """(B, M, C) or, without `up`, (B, C); skip (B, N, C') -> (B, N, C_out)."""
        if up is None:
            spread = coarse.unsqueeze(1).expand(-1, skip.shape[1], -1)
        else:
            spread = interpolate(coarse, *up)
        return self.mlp(torch.cat((spread, skip), dim=-1))  # type: ignore[no-any-return]


class HistoryEncoder(nn.Module):
    """The last cloud and its flow as 128 numbers >= 0; a learned vector if there is none."""

    def __init__(self, size: int = 128) -> None:
        super().__init__()
        self.sa1 = SetAbstraction((6, 64, 64, 128), rectify=True)
        self.sa2 = SetAbstraction((131, 128, 128, 256), rectify=True)
        self.sa3 = GlobalAbstraction((259, 256, 512, size), rectify=True)
        self.start = nn.Parameter(torch.empty(size))

    def forward(self, points: Tensor, flow: Tensor) -> Tensor:
        """(B, M, 3), (B, M, 3) -> (B, 128)."""
        geometry = cloud_geometry(points)
        first, second = geometry.levels
        x = self.sa2(self.sa1(flow, first), second)
        return self.sa3(x, second.centres)  # type: ignore[no-any-return]
