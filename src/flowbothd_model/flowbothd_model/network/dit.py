"""Parts of the diffusion transformer: adaptive blocks and the embedding of the noise level.

Peebles and Xie, Scalable Diffusion Models with Transformers (2023).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as fn


class Attention(nn.Module):
    """Self-attention over all tokens; no positions."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        """(B, T, D) -> (B, T, D)."""
        batch, tokens, width = x.shape
        qkv = self.qkv(x).view(batch, tokens, 3, self.heads, width // self.heads)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)  # 3 x (B, H, T, D/H)
        mixed = fn.scaled_dot_product_attention(q, k, v)  # (B, H, T, D/H)
        return self.out(mixed.transpose(1, 2).reshape(batch, tokens, width))  # type: ignore[no-any-return]


class Mlp(nn.Module):
    """Two layers, four times as wide inside, tanh-GELU."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.up = nn.Linear(width, 4 * width)
        self.down = nn.Linear(4 * width, width)

    def forward(self, x: Tensor) -> Tensor:
        """(..., D) -> (..., D)."""
        return self.down(fn.gelu(self.up(x), approximate="tanh"))  # type: ignore[no-any-return]


class PlainBlock(nn.Module):
    """A pre-norm transformer block without condition."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm1, self.attention = nn.LayerNorm(width), Attention(width, heads)
        self.norm2, self.mlp = nn.LayerNorm(width), Mlp(width)

    def forward(self, x: Tensor) -> Tensor:
        """(B, T, D) -> (B, T, D)."""
        x = x + self.attention(self.norm1(x))
        return x + self.mlp(self.norm2(x))  # type: ignore[no-any-return]


class AdaptiveBlock(nn.Module):
    """A block shifted, scaled and gated by the condition; starts as the identity."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width, elementwise_affine=False, eps=1e-6)
        self.attention = Attention(width, heads)
        self.norm2 = nn.LayerNorm(width, elementwise_affine=False, eps=1e-6)
        self.mlp = Mlp(width)
        self.modulation = nn.Linear(width, 6 * width)

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        """(B, T, D) tokens, (B, D) condition -> (B, T, D)."""
        parts = self.modulation(fn.silu(condition)).unsqueeze(1).chunk(6, dim=-1)
        shift1, scale1, gate1, shift2, scale2, gate2 = parts  # (B, 1, D) each
        x = x + gate1 * self.attention(self.norm1(x) * (1 + scale1) + shift1)
        return x + gate2 * self.mlp(self.norm2(x) * (1 + scale2) + shift2)  # type: ignore[no-any-return]


class AdaptiveOutput(nn.Module):
    """The final norm and projection, starting at zero."""

    def __init__(self, width: int, channels: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, elementwise_affine=False, eps=1e-6)
        self.modulation = nn.Linear(width, 2 * width)
        self.project = nn.Linear(width, channels)

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        """(B, T, D), (B, D) -> (B, T, channels)."""
        shift, scale = self.modulation(fn.silu(condition)).unsqueeze(1).chunk(2, dim=-1)
        return self.project(self.norm(x) * (1 + scale) + shift)  # type: ignore[no-any-return]


class LevelEmbedding(nn.Module):
    """256 sinusoids of the noise level through two layers."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Linear(256, width)
        self.second = nn.Linear(width, width)

    def forward(self, level: Tensor) -> Tensor:
        """(B,) level, of the order of 0..100 -> (B, D)."""
        frequency = torch.exp(
            -math.log(10_000.0) / 128 * torch.arange(128, device=level.device, dtype=level.dtype)
        )
        angle = level[:, None] * frequency  # (B, 128)
        waves = torch.cat((angle.cos(), angle.sin()), dim=-1)  # (B, 256)
        return self.second(fn.silu(self.first(waves)))  # type: ignore[no-any-return]


def initialise(module: nn.Module) -> None:
    """Xavier for every Linear; embedding 0.02; modulations and final projections zero."""
    for part in module.modules():
        if isinstance(part, nn.Linear):
            nn.init.xavier_uniform_(part.weight)
            if part.bias is not None:
                nn.init.zeros_(part.bias)
    for part in module.modules():
        if isinstance(part, LevelEmbedding):
            nn.init.normal_(part.first.weight, std=0.02)
            nn.init.normal_(part.second.weight, std=0.02)
        elif isinstance(part, AdaptiveBlock):
            nn.init.zeros_(part.modulation.weight)
        elif isinstance(part, AdaptiveOutput):
            nn.init.zeros_(part.modulation.weight)
            nn.init.zeros_(part.project.weight)
