"""Asks the simulation for the true flow of a cloud, from inside an async callback."""

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
from flowbothd_interfaces.srv import GroundTruthFlow
from flowbothd_policy.oracle import Truth

TRUTH = "sim/ground_truth_flow"


def truth_of(response: GroundTruthFlow.Response, count: int) -> Truth:
    """The truth in the simulation's answer for a cloud of `count` points.

    Raises:
        InvalidCloudError: a refusal, or an answer for another cloud.
    """
    if not response.ok:
        raise InvalidCloudError(f"{TRUTH} refused the cloud: {response.message}")
    points, flows = clouds.from_flow_message(response.flows)
    if len(points) != count:
        raise InvalidCloudError("true flow of another cloud", got=len(points), allowed=count)
    return Truth(flows, tuple(response.modes), response.open_ratio)


class TruthClient:
    """Client of the simulation's ground truth.

    Args:
        node: Whose executor serves the futures.
        timeout: Longest wait for an answer, steady clock [s].
    """

    def __init__(self, node: Node, timeout: float) -> None:
        self._node, self._timeout = node, timeout
        # The callback that awaits the answer keeps its own group busy meanwhile.
        self._group = ReentrantCallbackGroup()
        self._client = node.create_client(GroundTruthFlow, TRUTH, callback_group=self._group)
        # What a service answers is part of a run's story: a bag must hold it.
        self._client.configure_introspection(
            node.get_clock(), qos.EVENT, ServiceIntrospectionState.CONTENTS
        )
        # Simulated time stands still when the simulation is gone.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)

    def ready(self) -> bool:
        """Return True if the simulation serves the truth."""
        return bool(self._client.service_is_ready())

    async def ask(self, cloud: PointCloud2, count: int) -> Truth:
        """The true flow of a cloud of `count` points.

        Raises:
            InvalidCloudError: no answer in time, a refusal, or an answer for another cloud.
        """
        response = await self._answer(cloud)
        if response is None:
            raise InvalidCloudError(
                f"no answer from {TRUTH} within {self._timeout:g} s",
                hint="is the bridge node running? without a simulation use predictor model",
            )
        return truth_of(response, count)

    async def _answer(self, cloud: PointCloud2) -> GroundTruthFlow.Response | None:
        answer: Future = Future(executor=self._node.executor)
        asked = self._client.call_async(GroundTruthFlow.Request(cloud=cloud))

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
