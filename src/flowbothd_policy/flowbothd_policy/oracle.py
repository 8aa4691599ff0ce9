"""Predictors that know the truth of a simulation, plainly or with a network's ambiguity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import InvalidCloudError, ParameterError
from flowbothd_common.transforms import rotation_about
from flowbothd_common.types import Cloud, History, as_cloud
from flowbothd_policy.predictor import max_normalised

MODES = ("oracle", "ambiguous")
"""What an oracle may be asked to be."""


@dataclass(frozen=True)
class Truth:
    """Ground truth of a simulation for a cloud.

    Attributes:
        flows: (M, N, 3) float32; row 0 is the truth, the others what looks alike.
        modes: Name of each row.
        open_ratio: Of the target joint, 0..1.

    Raises:
        InvalidCloudError: no rows, or as many names as rows are missing.
    """

    flows: NDArray[np.float32]
    modes: tuple[str, ...]
    open_ratio: float

    def __post_init__(self) -> None:
        """Validate the shapes."""
        if self.flows.ndim != 3 or self.flows.shape[2] != 3 or not len(self.flows):
            raise InvalidCloudError(
                "true flow has the wrong shape", got=self.flows.shape, allowed="(M >= 1, N, 3)"
            )
        if len(self.modes) != len(self.flows):
            raise InvalidCloudError(
                "true flow and mode names differ in number", got=(len(self.flows), self.modes)
            )


@dataclass(frozen=True)
class OracleParams:
    """Errors of an oracle.

    Attributes:
        mode: ``oracle``: the truth; ``ambiguous``: closed, a random candidate; visibly open, the
            truth, or with some probability a wrong candidate.
        noise: Standard deviation per component of each point's own error, max-normalised.
        tilt: Standard deviation of a rotation common to all points of a sample [rad].
        wrong_mode_probability: Of a wrong candidate once the part is visibly open.
        open_threshold: Open ratio from which the part is visibly open.

    Raises:
        ParameterError: a value is out of range.
    """

    mode: str = "oracle"
    noise: float = 0.05
    tilt: float = 0.05
    wrong_mode_probability: float = 0.2
    open_threshold: float = 0.05

    def __post_init__(self) -> None:
        """Validate the values."""
        if self.mode not in MODES:
            raise ParameterError("unknown oracle mode", got=self.mode, allowed=", ".join(MODES))
        if self.noise < 0 or self.tilt < 0:
            raise ParameterError("noise of an oracle", got=(self.noise, self.tilt), allowed=">= 0")
        if not 0 <= self.wrong_mode_probability <= 1:
            raise ParameterError(
                "probability of a wrong mode", got=self.wrong_mode_probability, allowed="0..1"
            )


class OraclePredictor:
    """Samples around the truth.

    Args:
        truth: Tells the true flow of (N, 3) float32 points.
        params: How to err.
    """

    def __init__(self, truth: Callable[[Cloud], Truth], params: OracleParams | None = None) -> None:
        self._truth = truth
        self._params = params or OracleParams()
        self.model_id = self._params.mode

    def sample(
        self,
        points: Cloud,
        history: History | None = None,
        samples: int = 1,
        steps: int | None = None,
        sampler: str | None = None,
        seed: int | None = None,
    ) -> NDArray[np.float32]:
        """(samples, N, 3); see `FlowPredictor.sample`. History, steps and sampler are ignored."""
        cloud = as_cloud(points)
        return draw(self._truth(cloud), self._params, samples, seed)


def draw(truth: Truth, params: OracleParams, samples: int, seed: int | None) -> NDArray[np.float32]:
    """Draw (samples, N, 3) max-normalised fields around a truth.

    Raises:
        ParameterError: fewer than one sample.
    """
    if samples < 1:
        raise ParameterError("number of samples", got=samples, allowed=">= 1")
    rng = np.random.default_rng(seed)
    clean = max_normalised(truth.flows)
    return np.stack([_one(clean, truth.open_ratio, params, rng) for _ in range(samples)])


def _one(
    clean: NDArray[np.float32], open_ratio: float, params: OracleParams, rng: np.random.Generator
) -> NDArray[np.float32]:
    flow: NDArray[np.float32] = clean[0]
    if params.mode == "ambiguous":
        flow = _ambiguous(clean, open_ratio, params, rng)
    if not np.any(flow):
        return flow.copy()
    axis = rng.normal(size=3)
    turned = flow @ rotation_about(axis, rng.normal(scale=params.tilt)).T
    noisy = turned + rng.normal(scale=params.noise, size=flow.shape)
    result: NDArray[np.float32] = max_normalised(noisy[None])[0]
    return result


def _ambiguous(
    clean: NDArray[np.float32], open_ratio: float, params: OracleParams, rng: np.random.Generator
) -> NDArray[np.float32]:
    if open_ratio < params.open_threshold:
        candidate: NDArray[np.float32] = clean[rng.integers(len(clean))]
        return candidate
    if rng.random() >= params.wrong_mode_probability:
        truth: NDArray[np.float32] = clean[0]
        return truth
    # With a single candidate the wrong idea is that the part closes.
    wrong: NDArray[np.float32] = clean[rng.integers(1, len(clean))] if len(clean) > 1 else -clean[0]
    return wrong
