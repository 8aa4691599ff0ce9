"""One training loss: frame, noise, network, error. Chance comes from seed and step."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from flowbothd_model.config import Architecture, ModelConfig
from flowbothd_model.data.stream import Batch
from flowbothd_model.frames import into_frame
from flowbothd_model.network.diffusion import Diffusion
from flowbothd_model.network.implicit import implicit_prediction, relative_error
from flowbothd_model.network.network import FlowNetwork, HistoryBatch
from flowbothd_model.training.own_history import with_own_histories


def step_generator(seed: int, step: int, rank: int = 0) -> torch.Generator:
    """The source of levels and noise of one step; nothing has to be saved to resume."""
    return torch.Generator().manual_seed((seed * 1_000_003 + step) * 1009 + rank)


class Objective(nn.Module):
    """The loss as a module, so that several processes can share its gradients.

    Args:
        network: To be trained.
        config: Of the model.
        draws: Levels and noises per cloud; the cloud is encoded once for all of them.
        own_histories: Share of the histories that are the network's own.
    """

    def __init__(
        self,
        network: FlowNetwork,
        config: ModelConfig,
        draws: int = 1,
        own_histories: float = 0.0,
    ) -> None:
        super().__init__()
        self.network = network
        self.config = config
        self._draws = draws
        self._own_histories = own_histories
        self._diffusion = Diffusion(config.diffusion)

    def forward(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """Mean loss of a batch on the network's device; `generator` is on the CPU."""
        config = self.config
        points, past = into_frame(config.frame, batch.points, batch.history_points)
        history, told = None, torch.zeros_like(batch.has_history)
        if config.network.history and past is not None:
            flow, told = self._past_flow(batch, generator)
            history = HistoryBatch(past, flow, batch.has_history)
        if config.network.latent:
            return self._implicit(points, history, told, batch.flow, generator)
        if not config.network.diffusion:
            level = torch.ones(len(points), device=points.device)
            prediction = self.network(points, history, torch.zeros_like(points), level)
            if config.network.architecture is Architecture.COMPACT:  # as its parent is trained
                return relative_error(prediction.float(), batch.flow, 0.0).mean()
            loss: Tensor = (prediction - batch.flow).square().sum(-1).mean()
            return loss
        flow = batch.flow.repeat_interleave(self._draws, 0)
        level = self._diffusion.random_levels(len(flow), generator).to(points.device)
        noise = torch.randn(flow.shape, generator=generator).to(points.device)
        noisy = self._diffusion.noised(flow, noise, level)
        # The schedule counts in steps, as published; the embedding expects that magnitude.
        prediction = self.network(points, history, noisy, level * config.diffusion.steps)
        return self._diffusion.loss(prediction.float(), flow, noise, level)

    def _past_flow(self, batch: Batch, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """(B, M, 3) flow of the histories, true or the network's own; (B,) whether it tells."""
        flow, rows = batch.history_flow, batch.has_history
        if not self._own_histories or not bool(rows.any()):
            return flow, rows
        given, told = flow.clone(), rows.clone()
        given[rows], told[rows] = with_own_histories(
            self.network,
            self.config,
            batch.history_points[rows],
            flow[rows],
            self._own_histories,
            generator,
        )
        return given, told

    def _implicit(
        self,
        points: Tensor,
        history: HistoryBatch | None,
        told: Tensor,
        flow: Tensor,
        generator: torch.Generator,
    ) -> Tensor:
        """The nearest of several one-step flows learns."""
        settings = self.config.diffusion
        prediction = implicit_prediction(
            self.network,
            points,
            history,
            told,
            flow,
            self.config.network.latent,
            settings.hypotheses,
            settings.angle_weight,
            generator,
        )
        return relative_error(prediction.float(), flow, settings.angle_weight).mean()
