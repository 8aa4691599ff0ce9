"""Flow samples of a network for one request."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.types import Cloud, History
from flowbothd_policy.inference_params import InferenceParams
from flowbothd_policy.predictor import FlowPredictor


def sample_model(
    params: InferenceParams,
    model: FlowPredictor,
    points: Cloud,
    history: History | None,
    samples: int,
    seed: int,
) -> NDArray[np.float32]:
    """Draw (S, N, 3) float32 flows with the network, which sees cloud and history scaled."""
    scale = np.float32(params.cloud_scale)
    past = None if history is None else History(history.points * scale, history.flow)
    return model.sample(
        points * scale,
        past,
        samples,
        steps=params.steps or None,
        sampler=params.sampler or None,
        seed=seed,
    )
