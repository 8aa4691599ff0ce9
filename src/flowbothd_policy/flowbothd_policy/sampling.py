"""Flow samples for one request, from a network or from the simulation's truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import ParameterError
from flowbothd_common.types import Cloud, History
from flowbothd_policy.inference_params import InferenceParams
from flowbothd_policy.oracle import OracleParams, Truth, draw
from flowbothd_policy.predictor import FlowPredictor


def check_samples(params: InferenceParams, samples: int) -> None:
    """Refuse a number of samples that is out of range.

    Raises:
        ParameterError: fewer than one or more than `max_samples`.
    """
    if not 1 <= samples <= params.max_samples:
        raise ParameterError("number of samples", got=samples, allowed=f"1..{params.max_samples}")


def sample_model(
    params: InferenceParams,
    model: FlowPredictor,
    points: Cloud,
    history: History | None,
    samples: int,
    seed: int,
) -> NDArray[np.float32]:
    """(S, N, 3) float32 flows by the network, which sees cloud and history scaled."""
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


def sample_truth(
    params: InferenceParams, truth: Truth, samples: int, seed: int
) -> NDArray[np.float32]:
    """(S, N, 3) float32 flows by the oracle that the parameters describe."""
    oracle = OracleParams(
        params.predictor,
        params.noise,
        params.tilt,
        params.wrong_mode_probability,
        params.open_threshold,
    )
    return draw(truth, oracle, samples, seed)
