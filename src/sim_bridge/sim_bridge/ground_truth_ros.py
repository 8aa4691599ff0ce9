"""Client of the simulation's true flow, for use in async callbacks."""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.task import Future
from sensor_msgs.msg import PointCloud2

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.ros import clouds, qos
from flowbothd_interfaces import srv
from sim_bridge.oracle import GroundTruthFlow

GROUND_TRUTH = "sim/ground_truth_flow"
"""Service of bridge_node."""


def ground_truth_in(response: srv.GroundTruthFlow.Response, count: int) -> GroundTruthFlow:
    """Return the true flow in the simulation's answer for a cloud of `count` points.

    Raises:
        InvalidCloudError: a refusal, or an answer for another cloud.
    """
    if not response.ok:
        raise InvalidCloudError(f"{GROUND_TRUTH} refused the cloud: {response.message}")
    points, flows = clouds.from_flow_message(response.flows)
    if len(points) != count:
        raise InvalidCloudError("true flow of another cloud", got=len(points), allowed=count)
    return GroundTruthFlow(flows, tuple(response.modes), response.open_ratio)


class GroundTruthClient:
    """Client of the simulation's ground truth.

    Args:
        node: Node whose executor serves the futures.
        timeout: Longest wait for an answer, steady clock [s].
    """

    def __init__(self, node: Node, timeout: float) -> None:
        self._node, self._timeout = node, timeout
        # The callback that awaits the answer keeps its own group busy meanwhile.
        self._group = ReentrantCallbackGroup()
        self._client = node.create_client(
            srv.GroundTruthFlow, GROUND_TRUTH, callback_group=self._group
        )
        # A replay draws the samples again from these answers: a bag must hold them.
        self._client.configure_introspection(
            node.get_clock(), qos.EVENT, ServiceIntrospectionState.CONTENTS
        )
        # Simulated time stands still when the simulation is gone.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)

    def ready(self) -> bool:
        """Return whether the simulation is there."""
        return bool(self._client.service_is_ready())

    async def ask(self, cloud: PointCloud2, count: int) -> GroundTruthFlow:
        """Return the true flow of a cloud of `count` points.

        Raises:
            InvalidCloudError: no answer in time, a refusal, or an answer for another cloud.
        """
        response = await self._answer(cloud)
        if response is None:
            raise InvalidCloudError(
                f"no answer from {GROUND_TRUTH} within {self._timeout:g} s",
                hint="is bridge_node running? without a simulation start inference_node instead",
            )
        return ground_truth_in(response, count)

    async def _answer(self, cloud: PointCloud2) -> srv.GroundTruthFlow.Response | None:
        answer: Future = Future(executor=self._node.executor)
        asked = self._client.call_async(srv.GroundTruthFlow.Request(cloud=cloud))

        def settle(result: Any) -> None:
            if not answer.done():
                answer.set_result(result)

        asked.add_done_callback(lambda future: settle(future.result()))
        limit = self._node.create_timer(
            self._timeout, lambda: settle(None), callback_group=self._group, clock=self._steady
        )
        try:
            response = await answer
        finally:
            self._node.destroy_timer(limit)
            self._client.remove_pending_request(asked)
        return response
