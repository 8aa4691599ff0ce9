"""Predictors that know the truth of a simulation, plainly or with a network's ambiguity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import InvalidCloudError, ParameterError
from flowbothd_common.parameters import parameter
from flowbothd_common.transforms import rotation_about
from flowbothd_common.types import Cloud, History, as_cloud, max_normalised

ORACLES = ("oracle", "ambiguous")
"""Predictors that the simulation itself can serve."""


@dataclass(frozen=True)
class GroundTruthFlow:
    """Flows of a cloud that are true, or would be in another mode of the object.

    Attributes:
        flows: (M, N, 3) float32, each divided by its largest norm; row 0 is the truth, the others
            belong to modes that look alike.
        modes: M names, one for each row.
        open_ratio: Opening of the target joint, 0..1.

    Raises:
        InvalidCloudError: there are no rows, or the numbers of rows and names differ.
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
    """Errors that an oracle makes.

    Raises:
        ParameterError: a value is out of range.
    """

    predictor: str = parameter(
        "oracle",
        "oracle: the true flow with noise; ambiguous: like a network that does not know how a "
        "closed part opens",
        choices=ORACLES,
    )
    noise: float = parameter(
        0.05,
        "standard deviation of each point's own error, per component of max-normalised flow",
        minimum=0.0,
        maximum=10.0,
    )
    tilt: float = parameter(
        0.05,
        "standard deviation of a rotation common to all points of a sample [rad]",
        minimum=0.0,
        maximum=3.2,
    )
    wrong_mode_probability: float = parameter(
        0.2,
        "ambiguous: probability of a wrong way of opening once the part is visibly open",
        minimum=0.0,
        maximum=1.0,
    )
    open_threshold: float = parameter(
        0.05, "ambiguous: open ratio from which the part is visibly open", minimum=0.0, maximum=1.0
    )

    def __post_init__(self) -> None:
        """Validate values that did not come through ROS or a file."""
        if self.predictor not in ORACLES:
            raise ParameterError("unknown oracle", got=self.predictor, allowed=", ".join(ORACLES))
        if self.noise < 0 or self.tilt < 0:
            raise ParameterError("noise of an oracle", got=(self.noise, self.tilt), allowed=">= 0")
        if not 0 <= self.wrong_mode_probability <= 1:
            raise ParameterError(
                "probability of a wrong mode", got=self.wrong_mode_probability, allowed="0..1"
            )


@dataclass(frozen=True)
class OracleNodeParams(OracleParams):
    """Parameters of the oracle node: the errors that it makes, and its limits as a node."""

    truth_timeout: float = parameter(
        5.0, "wait for the simulation's answer [s]", minimum=0.1, maximum=600.0
    )
    max_samples: int = parameter(
        1000, "largest number of samples in one request", minimum=1, maximum=1000000
    )


class OraclePredictor:
    """A predictor that samples around the true flow; implements `FlowPredictor`.

    Args:
        truth: Returns the true flow of (N, 3) float32 points.
        params: Errors of the samples.
    """

    def __init__(
        self, truth: Callable[[Cloud], GroundTruthFlow], params: OracleParams | None = None
    ) -> None:
        self._truth = truth
        self._params = params or OracleParams()
        self.model_id = self._params.predictor

    def sample(
        self,
        points: Cloud,
        history: History | None = None,
        samples: int = 1,
        steps: int | None = None,
        sampler: str | None = None,
        seed: int | None = None,
    ) -> NDArray[np.float32]:
        """Draw (samples, N, 3) fields; history, steps and sampler are ignored."""
        cloud = as_cloud(points)
        return draw(self._truth(cloud), self._params, samples, seed)


def draw(
    truth: GroundTruthFlow, params: OracleParams, samples: int, seed: int | None
) -> NDArray[np.float32]:
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
    if params.predictor == "ambiguous":
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
