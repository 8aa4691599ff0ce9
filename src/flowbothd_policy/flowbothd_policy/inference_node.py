"""Serves `predict_flow` over a `FlowPredictor`, and publishes every answer on `flow/prediction`."""

from __future__ import annotations

import importlib
import sys
import time
from typing import Any

import numpy as np
from rclpy.lifecycle import LifecycleNode, State, TransitionCallbackReturn
from std_msgs.msg import Header

from flowbothd_common.errors import CheckpointError, FlowBotError
from flowbothd_common.ros import clouds, diagnostics, qos
from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from flowbothd_common.types import Cloud, History, as_cloud
from flowbothd_interfaces.msg import FlowPrediction
from flowbothd_interfaces.srv import PredictFlow
from flowbothd_policy.inference_params import InferenceParams
from flowbothd_policy.predictor import FlowPredictor
from flowbothd_policy.sampling import check_samples, sample_model, sample_truth
from flowbothd_policy.truth_ros import TRUTH, TruthClient


class InferenceNode(LifecycleNode):
    """Answers with flow fields from an oracle or a network; the network stays on one thread."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("inference_node", **kwargs)
        self._params = declare(self, InferenceParams)
        self._guard = Guard(self)
        self._status = diagnostics.NodeStatus(self, self._guard)
        self._model: FlowPredictor | None = None
        self._active = False
        self._failure: FlowBotError | None = None
        self._prediction = self.create_publisher(FlowPrediction, "flow/prediction", qos.EVENT)
        self._truth = TruthClient(self, self._params.truth_timeout)
        self._service = self.create_service(PredictFlow, "predict_flow", self._on_predict)
        self._guard.every(0.1, self._report)
        if self._params.autostart:
            self.trigger_configure()
            if self._failure is not None:
                raise self._failure
            self.trigger_activate()

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        """Load the network, if that is what predicts."""
        self._active, self._model, self._failure = False, None, None
        if self._params.predictor == "model":
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
        elif self._model is None and not self._truth.ready():
            self._status.report(diagnostics.ERROR, f"service {TRUTH} (bridge_node) is missing")
        else:
            self._status.report(diagnostics.OK, f"predicting with {self._params.predictor}")

    async def _on_predict(
        self, request: PredictFlow.Request, response: PredictFlow.Response
    ) -> PredictFlow.Response:
        start = time.monotonic()
        header = request.cloud.header
        none, history = np.empty((0, 3), np.float32), None
        response.flows = clouds.to_flow_message(header, none, none[None])
        try:
            points = as_cloud(clouds.from_cloud_message(request.cloud, clouds.XYZ).reshape(-1, 3))
            history = clouds.from_history_message(request.history)
            flows = await self._sample(request, points, history)
            response.flows = clouds.to_flow_message(header, points, flows)
            response.ok = True
        except FlowBotError as error:
            response.message = str(error)
            self._guard.refuse("predict_flow", response.message)
            self.get_logger().error(response.message, throttle_duration_sec=1.0)
        except Exception as error:
            # Answered, so that the policy need not wait for its timeout.
            response.message = f"prediction failed: {error!r}; see the log of inference_node"
            self._guard.fail("predict_flow", error)
        response.model_id = self._model.model_id if self._model else self._params.predictor
        response.seconds = time.monotonic() - start
        self._publish(header, request.seed, history is not None, response)
        return response

    def _publish(
        self, header: Header, seed: int, has_history: bool, response: PredictFlow.Response
    ) -> None:
        self._prediction.publish(
            FlowPrediction(
                header=header,
                seed=seed,
                has_history=has_history,
                flows=response.flows,
                model_id=response.model_id,
                seconds=response.seconds,
                ok=response.ok,
                message=response.message,
            )
        )

    async def _sample(
        self, request: PredictFlow.Request, points: Cloud, history: History | None
    ) -> np.ndarray:
        if not self._active:
            raise CheckpointError("inference is not active", hint="activate the lifecycle node")
        check_samples(self._params, request.samples)
        if self._model is None:
            truth = await self._truth.ask(request.cloud, len(points))
            return sample_truth(self._params, truth, request.samples, request.seed)
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
            "predictor model needs weights",
            hint="set model_path, or use predictor oracle or ambiguous against the simulation",
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
