"""Asking predictors and comparing their answers with the truth."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch

from flowbothd_common.types import Array, Cloud, History
from flowbothd_model.data.observation import Observation
from flowbothd_model.metrics import FlowErrors, flow_errors
from flowbothd_policy.predictor import FlowPredictor

AGREES = float(np.cos(np.radians(30.0)))
"""Mean cosine from which a flow agrees with the truth: the paper's 30 degrees."""


def seed_of(*parts: int) -> int:
    """A seed of its own for every combination of numbers."""
    return int(np.random.SeedSequence(parts).generate_state(1)[0])


def measure(
    predictor: FlowPredictor,
    seen: Observation,
    history: History | None,
    samples: int,
    seed: int,
) -> tuple[Cloud, FlowErrors]:
    """(samples, N, 3) flows for a cloud, and their errors over the points that move."""
    flows = predictor.sample(seen.points, history, samples, seed=seed)
    return flows, flow_errors(torch.from_numpy(flows), torch.from_numpy(seen.flow))


def truth_of(seen: Observation) -> History:
    """The observation with its true flow, as a history."""
    return History(seen.points, seen.flow)


def rounded(values: Iterable[float] | Array | torch.Tensor) -> list[float | None]:
    """For JSON: four decimals, None where a value is not finite."""
    return [round(float(v), 4) if np.isfinite(float(v)) else None for v in values]


def mean(values: Iterable[float]) -> float | None:
    """Mean for JSON; None of nothing."""
    kept = [float(v) for v in values]
    return round(float(np.mean(kept)), 4) if kept else None


Plain = dict[str, Any]
"""JSON-able results."""
