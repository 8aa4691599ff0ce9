"""A fixed set of held-out clouds, and the winner-take-all scores of a network on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from flowbothd_model.config import ModelConfig
from flowbothd_model.data.sampling import Sample, Situation
from flowbothd_model.data.stream import Mixture, collate
from flowbothd_model.metrics import FlowErrors, flow_errors
from flowbothd_model.network.network import FlowNetwork
from flowbothd_model.network.sampler import encode_batch, sample_flows


class ValidationSet:
    """Clouds that stay the same during a run.

    Args:
        mixture: Of held-out objects.
        count: Clouds.
        samples: Drawn per cloud.
    """

    def __init__(self, mixture: Mixture, count: int, samples: int = 20) -> None:
        self.clouds: Sequence[Sample] = [mixture.sample_at(0, i) for i in range(count)]
        self._samples = samples

    def measure(self, network: FlowNetwork, config: ModelConfig) -> dict[str, float]:
        """Mean scores, over all clouds and per situation."""
        errors = [
            errors_of(network, config, cloud, self._samples, seed=i)
            for i, cloud in enumerate(self.clouds)
        ]
        situations = [cloud.situation for cloud in self.clouds]
        scores = {
            "wta_mean_error": _mean([float(e.mean_error[e.winner]) for e in errors]),
            "wta_cosine": _mean([float(e.cosine[e.winner]) for e in errors]),
        }
        for situation in Situation:
            own = [e for e, s in zip(errors, situations, strict=True) if s is situation]
            scores[f"wta_cosine_{situation}"] = _mean([float(e.cosine[e.winner]) for e in own])
            scores[f"mean_cosine_{situation}"] = _mean([float(e.cosine.mean()) for e in own])
        return scores


def errors_of(
    network: FlowNetwork,
    config: ModelConfig,
    cloud: Sample,
    samples: int,
    seed: int,
    sampler: str | None = None,
    steps: int | None = None,
) -> FlowErrors:
    """Errors of `samples` samples on one cloud."""
    device = next(network.parameters()).device
    batch = collate([cloud]).to(device)
    with torch.inference_mode():
        context = encode_batch(
            network,
            config,
            batch.points,
            batch.history_points,
            batch.history_flow,
            batch.has_history,
        )
        flows = sample_flows(network, config, context, samples, seed, sampler, steps)
    return flow_errors(flows.cpu(), torch.from_numpy(cloud.current.flow))


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")
