"""Serves `predict_flow` from the simulation's true flow, in the place of inference_node."""

from __future__ import annotations

from typing import Any

import numpy as np
from rclpy.node import Node

from flowbothd_common.ros import diagnostics
from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from flowbothd_common.ros.prediction_server import PredictionServer
from flowbothd_common.types import Cloud, History
from flowbothd_interfaces.srv import PredictFlow
from sim_bridge.ground_truth_ros import GROUND_TRUTH, GroundTruthClient
from sim_bridge.oracle import OracleNodeParams, draw


class OracleNode(Node):
    """Draws flow fields around the true flow that bridge_node knows."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("oracle_node", **kwargs)
        self._params = declare(self, OracleNodeParams)
        self._guard = Guard(self)
        self._status = diagnostics.NodeStatus(self, self._guard)
        self._truth = GroundTruthClient(self, self._params.truth_timeout)
        self._server = PredictionServer(
            self, self._guard, self._sample, self._model_id, self._params.max_samples
        )
        self._guard.every(0.1, self._report)

    def destroy_node(self) -> None:
        """Stop the heartbeat before its publisher is gone."""
        self._status.close()
        super().destroy_node()

    def _model_id(self) -> str:
        return self._params.predictor

    def _report(self) -> None:
        if self._truth.ready():
            self._status.report(diagnostics.OK, f"predicting with {self._params.predictor}")
        else:
            missing = f"service {GROUND_TRUTH} (bridge_node) is missing"
            self._status.report(diagnostics.ERROR, missing)

    async def _sample(
        self, request: PredictFlow.Request, points: Cloud, history: History | None
    ) -> np.ndarray:
        truth = await self._truth.ask(request.cloud, len(points))
        return draw(truth, self._params, request.samples, request.seed)


def main(args: list[str] | None = None) -> int:
    """Run the node until it is asked to stop."""
    return run_node(OracleNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
