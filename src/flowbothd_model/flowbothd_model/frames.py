"""Normalisation of clouds before they enter the network, and of flows."""

from __future__ import annotations

from torch import Tensor

from flowbothd_model.config import Frame


def into_frame(frame: Frame, points: Tensor, others: Tensor | None) -> tuple[Tensor, Tensor | None]:
    """Map clouds (B, N, 3), and with them a second cloud of the same scene (B, M, 3).

    `world` leaves them as they are, as published. `centred` moves the mean of the first to zero
    and scales its root mean square distance to one; the second goes with it, so that the motion
    between them is kept. Flows are max-normalised and need no scale.
    """
    if frame is Frame.WORLD:
        return points, others
    mean = points.mean(1, keepdim=True)
    spread = (points - mean).square().sum(-1).mean(1).sqrt().clamp(min=1e-6)[:, None, None]
    return (points - mean) / spread, None if others is None else (others - mean) / spread


def max_normalised(flow: Tensor) -> Tensor:
    """(..., N, 3) flow over its largest norm plus 1e-6, cloud by cloud."""
    scaled: Tensor = flow / (flow.norm(dim=-1).amax(-1) + 1e-6)[..., None, None]
    return scaled
