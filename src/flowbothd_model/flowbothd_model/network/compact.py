"""The compact network: patches of the cloud as tokens, one encoding per cloud, cheap steps.

Three thoughts make it cheap. The geometry (patches, their features, the history) is encoded once
per cloud and shared by all steps and samples. A step works on patches (96 in preset `compact`), not
on points. And every point reads its flow from the three patches nearest to it, by weights learned
from the geometry, so that the edge of a moving part may stay sharp.

The shipped weights map one random vector per sample to a flow, in a single step (`latent` > 0,
implicit.py). As a diffusion chain (preset `compact-diffusion`) the network sees the noisy flow as
its mean and its first moments over each patch, which hold all that is rigid in it.

| symbol | meaning |
|---|---|
| B, N | clouds, points of a cloud |
| T, H | tokens of the current cloud (96) and of the history (32) |
| K | points of a patch |
| D | width |
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from flowbothd_model.config import NetworkConfig
from flowbothd_model.network.dit import (
    AdaptiveBlock,
    AdaptiveOutput,
    LevelEmbedding,
    PlainBlock,
    initialise,
)
from flowbothd_model.network.geometry import farthest_points, gather, nearest
from flowbothd_model.network.network import Context, FlowNetwork, HistoryBatch

_LOCAL = 64  # channels of what is computed for every point
_BLEND = 3  # patches that a point reads from
_GAIN = 4.0  # brings the mean noisy flow of a patch to the order of one
_DENSITY = 1024  # points of the cloud for which the number of neighbours is given


class PatchEncoder(nn.Module):
    """Patches of a cloud (and of values on it) as tokens: a small PointNet per patch."""

    def __init__(self, tokens: int, neighbours: int, channels: int, width: int) -> None:
        super().__init__()
        self.tokens, self.neighbours = tokens, neighbours
        self.point = nn.Sequential(nn.Linear(3 + channels, 32), nn.ReLU(), nn.Linear(32, _LOCAL))
        self.patch = nn.Sequential(nn.Linear(_LOCAL + 1, width), nn.GELU(), nn.Linear(width, width))
        self.position = nn.Sequential(nn.Linear(3, width), nn.GELU(), nn.Linear(width, width))

    def forward(self, points: Tensor, values: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """(B, N, 3), (B, N, C) -> (B, T, D) tokens, (B, T, 3) centres, (B, T, 1) radii."""
        total = points.shape[1]
        neighbours = max(4, min(64, round(self.neighbours * total / _DENSITY)))
        chosen = farthest_points(points, min(self.tokens, total))
        centres = gather(points, chosen)  # (B, T, 3)
        distances, index = nearest(centres, points, neighbours)  # (B, T, K)
        radius = distances[..., -1:].sqrt().clamp(min=1e-6)  # (B, T, 1)
        local = (gather(points, index) - centres.unsqueeze(2)) / radius.unsqueeze(2)
        if values is not None:
            local = torch.cat((local, gather(values, index)), dim=-1)  # (B, T, K, 3 + C)
        pooled = self.point(local).amax(2)  # (B, T, 64)
        token = self.patch(torch.cat((pooled, radius.log()), dim=-1)) + self.position(centres)
        return token, centres, radius


class CompactNetwork(FlowNetwork):
    """See the module."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        width = config.width
        self.config = config
        self.patches = PatchEncoder(config.tokens, config.neighbours, 0, width)
        self.history_patches = PatchEncoder(config.history_tokens, 2 * config.neighbours, 3, width)
        self.no_history = nn.Parameter(torch.empty(width))
        self.history_mark = nn.Parameter(torch.empty(width))
        self.encoder = nn.ModuleList(
            PlainBlock(width, config.heads) for _ in range(config.encoder_layers)
        )
        self.encoder_norm = nn.LayerNorm(width)
        self.point = nn.Sequential(
            nn.Linear(4 * _BLEND + 3, _LOCAL), nn.ReLU(), nn.Linear(_LOCAL, _LOCAL)
        )
        self.point_query = nn.Linear(_LOCAL, 16)
        self.token_key = nn.Linear(width, 16)
        if config.latent:
            self.latent = nn.Sequential(
                nn.Linear(config.latent, width), nn.SiLU(), nn.Linear(width, width)
            )
        elif config.diffusion:
            self.noisy = nn.Linear(12, width)
            self.noisy_point = nn.Linear(3, _LOCAL)
            self.copy = nn.Linear(width, 1)
        self.level = LevelEmbedding(width)
        self.blocks = nn.ModuleList(
            AdaptiveBlock(width, config.heads) for _ in range(config.denoiser_layers)
        )
        self.to_points = AdaptiveOutput(width, _LOCAL)
        self.head = nn.Sequential(
            nn.ReLU(), nn.Linear(_LOCAL, _LOCAL), nn.ReLU(), nn.Linear(_LOCAL, 3)
        )
        initialise(self)
        nn.init.xavier_uniform_(self.to_points.project.weight)
        nn.init.zeros_(self.head[-1].weight)  # type: ignore[arg-type]
        nn.init.normal_(self.no_history)
        nn.init.normal_(self.history_mark, std=0.02)

    def encode(self, points: Tensor, history: HistoryBatch | None) -> Context:
        """Patches, history and the points' own features: (B, N, 3) -> context."""
        tokens, centres, radius = self.patches(points, None)  # (B, T, D), (B, T, 3), (B, T, 1)
        x = torch.cat((tokens, self._history_tokens(tokens, history)), dim=1)  # (B, T + H, D)
        for block in self.encoder:
            x = block(x)
        tokens = self.encoder_norm(x[:, : tokens.shape[1]])  # (B, T, D)
        distances, index = nearest(points, centres, _BLEND)  # (B, N, 3)
        near_radius = gather(radius, index)  # (B, N, 3, 1)
        local = (points.unsqueeze(2) - gather(centres, index)) / near_radius  # (B, N, 3, 3)
        spread = distances / near_radius.squeeze(-1).square()  # (B, N, 3)
        feature = self.point(torch.cat((local.flatten(2), spread, points), dim=-1))  # (B, N, 64)
        key = gather(self.token_key(tokens), index)  # (B, N, 3, 16)
        match = (key * self.point_query(feature).unsqueeze(2)).sum(-1) * key.shape[-1] ** -0.5
        weights = (match - 2.0 * spread).softmax(-1)  # (B, N, 3)
        shape = (*points.shape[:2], tokens.shape[1])
        blend = points.new_zeros(shape).scatter_(2, index, weights.to(points.dtype))  # (B, N, T)
        member = points.new_zeros(shape).scatter_(2, index[..., :1], 1.0)
        member = member / member.sum(1, keepdim=True).clamp(min=1.0)
        return Context(
            tokens=tokens, feature=feature, blend=blend, member=member, local=local[:, :, 0]
        )

    def _history_tokens(self, tokens: Tensor, history: HistoryBatch | None) -> Tensor:
        """(B, H, D): patches of the history, or the learned start vector where there is none."""
        shape = (len(tokens), self.config.history_tokens, tokens.shape[-1])
        none = self.no_history.expand(shape)
        if history is None or not self.config.history:
            return none
        encoded = self.history_patches(history.points, history.flow)[0] + self.history_mark
        return torch.where(history.present[:, None, None], encoded, none)

    def points_of(self, context: Context) -> int:
        """Points per cloud of a context."""
        return context["feature"].shape[1]

    def denoise(self, context: Context, noisy: Tensor, level: Tensor) -> Tensor:
        """(B, N, 3) noisy flow and (B,) level -> (B, N, 3) flow.

        With a latent, (B * S, latent) vectors, those of a cloud one after the other, take the
        place of the noisy flow, and the answer has B * S flows.
        """
        if self.config.latent:
            return self._from_vectors(context, noisy, level)
        x = context["tokens"]
        condition = self.level(level)  # (B, D)
        if self.config.diffusion:
            pooled = self._pooled(context, noisy)  # (B, T, 12)
            x = x + self.noisy(pooled)  # (B, T, D)
        for block in self.blocks:
            x = block(x, condition)
        x = self.to_points(x, condition)  # (B, T, 64)
        point = context["blend"] @ x + context["feature"]  # (B, N, 64)
        if not self.config.diffusion:
            return self.head(point)  # type: ignore[no-any-return]
        # A short way past the transformer: where noise is low, the answer is nearly there already.
        smooth = context["blend"] @ pooled[..., :3]  # (B, N, 3)
        share = self.copy(fn.silu(condition)).unsqueeze(1)  # (B, 1, 1)
        return self.head(point + self.noisy_point(smooth)) + share * smooth  # type: ignore[no-any-return]

    def _pooled(self, context: Context, noisy: Tensor) -> Tensor:
        """(B, T, 12) mean and first moments of the (B, N, 3) noisy flow over every patch."""
        local = context["local"]  # (B, N, 3): where in its patch a point lies
        moments = torch.cat(
            (noisy, (noisy.unsqueeze(-1) * local.unsqueeze(-2)).flatten(2)), dim=-1
        )  # (B, N, 12)
        return _GAIN * (context["member"].transpose(1, 2) @ moments)

    def _from_vectors(self, context: Context, vectors: Tensor, level: Tensor) -> Tensor:
        """(B * S, latent) vectors -> (B * S, N, 3): what belongs to the points is not repeated."""
        clouds, tokens = context["tokens"].shape[:2]
        count = len(vectors) // clouds  # S
        condition = self.level(level) + self.latent(vectors)  # (B * S, D)
        x = context["tokens"].repeat_interleave(count, 0)  # (B * S, T, D)
        for block in self.blocks:
            x = block(x, condition)
        x = self.to_points(x, condition)  # (B * S, T, 64)
        x = x.view(clouds, count, tokens, _LOCAL).transpose(1, 2).flatten(2)  # (B, T, S * 64)
        point = (context["blend"] @ x).unflatten(2, (count, _LOCAL))  # (B, N, S, 64)
        flow = self.head(point + context["feature"].unsqueeze(2))  # (B, N, S, 3)
        return flow.transpose(1, 2).flatten(0, 1)  # type: ignore[no-any-return]
