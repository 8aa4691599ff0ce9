"""The predictor once more on what it was asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flowbothd.replay.story import Stamp, Story
from flowbothd_common.parameters import build, specifications
from flowbothd_model.describe import describe
from flowbothd_policy.commands import Predict
from flowbothd_policy.inference_node import load_model
from flowbothd_policy.inference_params import InferenceParams
from flowbothd_policy.predictor import FlowPredictor
from flowbothd_policy.sampling import sample_model, sample_truth
from flowbothd_policy.truth_ros import truth_of
from flowbothd_rosbag.metadata import BagError

NODE = "inference_node"


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
        if NODE not in story.parameters:
            raise BagError(f"the recording has no parameters of {NODE}")
        known = {spec.name for spec in specifications(InferenceParams)}
        values = {k: v for k, v in story.parameters[NODE].items() if k in known}
        self._params = build(InferenceParams, values)
        self._story = story
        self._model: FlowPredictor | None = None
        self.problems: list[str] = []
        if self._params.predictor == "model":
            self._load()

    def _load(self) -> None:
        import torch

        # As in the node's own environment; other numbers of threads add in another order.
        torch.set_num_threads(1)
        self._model = load_model(self._params)
        recorded = self._story.weights.get(NODE, {}).get("sha256")
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
        truth = truth_of(response, len(asked.points))
        return sample_truth(self._params, truth, asked.samples, asked.seed)
