"""The service `predict_flow`, as every node that predicts flow offers it."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Header

from flowbothd_common.errors import FlowBotError, ParameterError
from flowbothd_common.ros import clouds, qos
from flowbothd_common.ros.guard import Guard
from flowbothd_common.types import Cloud, History, as_cloud
from flowbothd_interfaces.msg import FlowPrediction
from flowbothd_interfaces.srv import PredictFlow

Sample = Callable[[PredictFlow.Request, Cloud, History | None], Awaitable[NDArray[np.float32]]]
"""Draw (samples, N, 3) flows for a request, its (N, 3) points and its history."""


class PredictionServer:
    """Serves `predict_flow`, and publishes every answer on `flow/prediction`.

    A request that cannot be served is answered at once with `ok` false and the reason, so that
    the policy does not wait for its timeout.

    Args:
        node: Node that offers the service.
        guard: Guard of the node's callbacks; gets what is refused or fails.
        sample: Coroutine function that draws the flows. It raises a FlowBotError for a request
            that it refuses.
        model_id: Returns the name that answers carry.
        max_samples: Largest number of samples in one request.
    """

    def __init__(
        self,
        node: Node,
        guard: Guard,
        sample: Sample,
        model_id: Callable[[], str],
        max_samples: int,
    ) -> None:
        self._node, self._guard = node, guard
        self._sample, self._model_id, self._max_samples = sample, model_id, max_samples
        self._prediction = node.create_publisher(FlowPrediction, "flow/prediction", qos.EVENT)
        self._service = node.create_service(PredictFlow, "predict_flow", self._on_predict)

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
            self._check_samples(request.samples)
            flows = await self._sample(request, points, history)
            response.flows = clouds.to_flow_message(header, points, flows)
            response.ok = True
        except FlowBotError as error:
            response.message = str(error)
            self._guard.refuse("predict_flow", response.message)
            self._node.get_logger().error(response.message, throttle_duration_sec=1.0)
        except Exception as error:
            name = self._node.get_name()
            response.message = f"prediction failed: {error!r}; see the log of {name}"
            self._guard.fail("predict_flow", error)
        response.model_id = self._model_id()
        response.seconds = time.monotonic() - start
        self._publish(header, request.seed, history is not None, response)
        return response

    def _check_samples(self, samples: int) -> None:
        if not 1 <= samples <= self._max_samples:
            raise ParameterError(
                "number of samples", got=samples, allowed=f"1..{self._max_samples}"
            )

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
