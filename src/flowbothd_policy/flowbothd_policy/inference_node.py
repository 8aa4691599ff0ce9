"""Serves `predict_flow` with a network, and publishes every answer on `flow/prediction`."""

from __future__ import annotations

import importlib
import sys
from typing import Any

import numpy as np
from rclpy.lifecycle import LifecycleNode, State, TransitionCallbackReturn

from flowbothd_common.errors import CheckpointError, FlowBotError
from flowbothd_common.ros import diagnostics
from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from flowbothd_common.ros.prediction_server import PredictionServer
from flowbothd_common.types import Cloud, History
from flowbothd_interfaces.srv import PredictFlow
from flowbothd_policy.inference_params import InferenceParams
from flowbothd_policy.predictor import FlowPredictor
from flowbothd_policy.sampling import sample_model


class InferenceNode(LifecycleNode):
    """Answers with flow fields of a network, which stays on one thread."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("inference_node", **kwargs)
        self._params = declare(self, InferenceParams)
        self._guard = Guard(self)
        self._status = diagnostics.NodeStatus(self, self._guard)
        self._model: FlowPredictor | None = None
        self._active = False
        self._failure: FlowBotError | None = None
        self._server = PredictionServer(
            self, self._guard, self._sample, self._model_id, self._params.max_samples
        )
        self._guard.every(0.1, self._report)
        if self._params.autostart:
            self.trigger_configure()
            if self._failure is not None:
                raise self._failure
            self.trigger_activate()

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        """Load the network."""
        self._active, self._model, self._failure = False, None, None
        try:
            self._model = load_model(self._params)
        except FlowBotError as error:
            # rclpy would swallow the error; with autostart the constructor raises it.
            self._failure = error
            self._status.report(diagnostics.ERROR, str(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: State) -> TransitionCallbackReturn:
        """Begin to answer."""
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: State) -> TransitionCallbackReturn:
        """Refuse requests."""
        self._active = False
        return super().on_deactivate(state)

    def destroy_node(self) -> None:
        """Stop the heartbeat before its publisher goes."""
        self._status.close()
        super().destroy_node()

    def _report(self) -> None:
        if not self._active:
            self._status.report(diagnostics.ERROR, "not active: configure and activate the node")
        else:
            self._status.report(diagnostics.OK, f"predicting with {self._model_id()}")

    def _model_id(self) -> str:
        return self._model.model_id if self._model else ""

    async def _sample(
        self, request: PredictFlow.Request, points: Cloud, history: History | None
    ) -> np.ndarray:
        if self._model is None or not self._active:
            raise CheckpointError("inference is not active", hint="activate the lifecycle node")
        return sample_model(
            self._params, self._model, points, history, request.samples, request.seed
        )


def load_model(params: InferenceParams) -> FlowPredictor:
    """Load the network named by the parameters; imports torch only now.

    Raises:
        CheckpointError: no path, no flowbothd_model, or weights that cannot be loaded.
    """
    if not params.model_path:
        raise CheckpointError(
            "the inference node needs weights",
            hint="set model_path; against the simulation oracle_node predicts without any",
        )
    try:
        module = importlib.import_module("flowbothd_model")
        load = module.load
    except (ImportError, AttributeError) as error:
        raise CheckpointError(f"the network is not installed: {error}") from error
    predictor: FlowPredictor = load(params.model_path, params.device)
    return predictor


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(InferenceNode, args)


if __name__ == "__main__":
    sys.exit(main())
