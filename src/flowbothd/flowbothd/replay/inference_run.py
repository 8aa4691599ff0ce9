"""The predictor once more on what it was asked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flowbothd.replay.story import INFERENCE_NODE, ORACLE_NODE, Stamp, Story, oracle_parameters
from flowbothd_common.parameters import build, specifications
from flowbothd_model.describe import describe
from flowbothd_policy.commands import Predict
from flowbothd_policy.inference_node import load_model
from flowbothd_policy.inference_params import InferenceParams
from flowbothd_policy.predictor import FlowPredictor
from flowbothd_policy.sampling import sample_model
from flowbothd_rosbag.metadata import BagError
from sim_bridge.ground_truth_ros import ground_truth_in
from sim_bridge.oracle import OracleParams, draw


class Inference:
    """The predictor that a recording used.

    Args:
        story: Says which.

    Attributes:
        problems: Why its answers may differ.

    Raises:
        BagError: the recording does not say who predicted.
        CheckpointError: the weights are not here.
    """

    def __init__(self, story: Story) -> None:
        self._story = story
        self._model: FlowPredictor | None = None
        self.problems: list[str] = []
        oracle = oracle_parameters(story.parameters)
        if oracle is not None:
            self._oracle = build(OracleParams, _known(OracleParams, oracle))
        elif INFERENCE_NODE in story.parameters:
            values = _known(InferenceParams, story.parameters[INFERENCE_NODE])
            self._params = build(InferenceParams, values)
            self._load()
        else:
            raise BagError(
                f"the recording has parameters neither of {INFERENCE_NODE} nor of {ORACLE_NODE}"
            )

    def _load(self) -> None:
        import torch

        # As in the node's own environment; other numbers of threads add in another order.
        torch.set_num_threads(1)
        self._model = load_model(self._params)
        recorded = self._story.weights.get(INFERENCE_NODE, {}).get("sha256")
        here = describe(self._params.model_path).get("sha256")
        if recorded and recorded != here:
            self.problems.append(
                f"weights {self._params.model_path} are others than recorded: sha256 {here}, "
                f"recorded {recorded}"
            )

    def answer(self, asked: Predict, stamp: Stamp) -> NDArray[np.float32]:
        """(S, N, 3) flows.

        Raises:
            BagError: the simulation's truth for this cloud was not recorded.
        """
        if self._model is not None:
            return sample_model(
                self._params,
                self._model,
                asked.points,
                asked.history,
                asked.samples,
                asked.seed,
            )
        response = self._story.truths.get(stamp)
        if response is None:
            raise BagError(
                f"the recording has no true flow for the cloud at {stamp}",
                hint="an oracle can be recomputed only where its service's events were recorded",
            )
        truth = ground_truth_in(response, len(asked.points))
        return draw(truth, self._oracle, asked.samples, asked.seed)


def _known(params: type, values: Mapping[str, Any]) -> dict[str, Any]:
    names = {spec.name for spec in specifications(params)}
    return {name: value for name, value in values.items() if name in names}
