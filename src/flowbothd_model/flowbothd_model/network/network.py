"""Interface of all networks: one encoding per cloud, then cheap denoising steps."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class HistoryBatch:
    """The last observation and motion of every cloud of a batch.

    Attributes:
        points: (B, M, 3), in the same frame as the current points.
        flow: (B, M, 3).
        present: (B,) bool; rows where it is False are ignored.
    """

    points: Tensor
    flow: Tensor
    present: Tensor


class Context:
    """Encoding computed once per cloud. Tensors have the batch first; `repeated` serves samples."""

    def __init__(self, **tensors: Tensor | None) -> None:
        self._tensors = tensors

    def __getitem__(self, name: str) -> Tensor:
        """A tensor that must be there."""
        value = self._tensors[name]
        if value is None:
            raise KeyError(name)
        return value

    def get(self, name: str) -> Tensor | None:
        """A tensor, or None."""
        return self._tensors.get(name)

    @property
    def device(self) -> torch.device:
        """Device of the tensors."""
        return next(value.device for value in self._tensors.values() if value is not None)

    @property
    def clouds(self) -> int:
        """Number of encoded clouds."""
        return next(len(value) for value in self._tensors.values() if value is not None)

    def repeated(self, times: int) -> Context:
        """Every cloud `times` times in a row, without encoding it again."""
        if times == 1:
            return self

        def repeat(value: Tensor) -> Tensor:
            if len(value) == 1:  # a view: nothing is copied for the samples of one cloud
                return value.expand(times, *value.shape[1:])
            return value.repeat_interleave(times, 0)

        return Context(
            **{name: None if v is None else repeat(v) for name, v in self._tensors.items()}
        )


class FlowNetwork(nn.Module):
    """Base of the networks."""

    def encode(self, points: Tensor, history: HistoryBatch | None) -> Context:
        """Geometry and features of (B, N, 3) `points` that no denoising step changes."""
        raise NotImplementedError

    def denoise(self, context: Context, noisy: Tensor, level: Tensor) -> Tensor:
        """(B, N, 3) prediction from a (B, N, 3) noisy flow at (B,) levels.

        Networks with a latent take (B * S, latent) vectors, S in a row for each cloud, instead.
        """
        raise NotImplementedError

    def points_of(self, context: Context) -> int:
        """Points per cloud of a context."""
        raise NotImplementedError

    def forward(
        self, points: Tensor, history: HistoryBatch | None, noisy: Tensor, level: Tensor
    ) -> Tensor:
        """Encode and denoise; `noisy` (B * k, N, 3) may hold k draws in a row for each cloud."""
        context = self.encode(points, history)
        return self.denoise(context.repeated(len(noisy) // len(points)), noisy, level)
