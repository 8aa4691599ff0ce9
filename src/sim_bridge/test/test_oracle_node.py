"""The oracle node against a stand-in for the bridge that knows the truth."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

DOMAIN = 64
POINTS = np.random.default_rng(3).uniform(-0.3, 0.3, (50, 3)).astype(np.float32)
PULL = np.tile(np.float32([-1, 0, 0]), (len(POINTS), 1))


class Graph:
    """An oracle node, and a neighbour that asks it and answers for the bridge."""

    def __init__(self, *, bridge=True, **overrides):
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.parameter import Parameter

        from flowbothd_common.ros import qos
        from flowbothd_interfaces.msg import FlowPrediction
        from flowbothd_interfaces.srv import GroundTruthFlow, PredictFlow
        from sim_bridge.oracle_node import OracleNode

        self.context = Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        values = [Parameter(name, value=value) for name, value in overrides.items()]
        try:
            self.oracle = OracleNode(context=self.context, parameter_overrides=values)
        except BaseException:
            rclpy.shutdown(context=self.context)
            raise
        self.neighbour = Node("neighbour", context=self.context)
        self.refusal, self.asked, self.predictions = "", [], []
        if bridge:
            name = "sim/ground_truth_flow"
            self.neighbour.create_service(GroundTruthFlow, name, self.on_truth)
        self.neighbour.create_subscription(
            FlowPrediction, "flow/prediction", self.predictions.append, qos.EVENT
        )
        self.predict = self.neighbour.create_client(PredictFlow, "predict_flow")
        self.executor = SingleThreadedExecutor(context=self.context)
        for node in (self.oracle, self.neighbour):
            self.executor.add_node(node)

    def on_truth(self, request, response):
        from flowbothd_common.ros import clouds

        self.asked.append(request)
        response.ok, response.message = not self.refusal, self.refusal
        points = clouds.from_cloud_message(request.cloud, clouds.XYZ).reshape(-1, 3)
        flows = np.stack([PULL, -PULL])
        response.flows = clouds.to_flow_message(request.cloud.header, points, flows)
        response.modes = ["pull", "push"]
        return response

    def until(self, condition, what, seconds=20.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"{what} did not come within {seconds} s"
            self.executor.spin_once(timeout_sec=0.05)

    def ask(self, points=POINTS, samples=2, seed=3):
        from std_msgs.msg import Header

        from flowbothd_common.ros import clouds
        from flowbothd_interfaces.srv import PredictFlow

        cloud = clouds.to_cloud_message(Header(frame_id="panda_link0"), points, clouds.XYZ)
        self.until(self.predict.service_is_ready, "predict_flow")
        request = PredictFlow.Request(cloud=cloud, samples=samples, seed=seed)
        future = self.predict.call_async(request)
        self.until(future.done, "the answer")
        return future.result()

    def close(self):
        import rclpy

        self.executor.shutdown()
        for node in (self.oracle, self.neighbour):
            node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def start(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    graphs = []

    def make(**options):
        graphs.append(Graph(**options))
        return graphs[-1]

    yield make
    for graph in graphs:
        graph.close()


def test_it_answers_publishes_and_repeats(start):
    from flowbothd_common.ros import clouds

    graph = start(predictor="ambiguous", noise=0.0, tilt=0.0)
    response = graph.ask(samples=20)
    assert response.ok, response.message
    points, flows = clouds.from_flow_message(response.flows)
    np.testing.assert_array_equal(points, POINTS)
    assert flows.shape == (20, len(POINTS), 3)
    assert {float(flow[0, 0]) for flow in flows} == {-1.0, 1.0}
    assert bytes(graph.ask(samples=20).flows.data) == bytes(response.flows.data)
    assert bytes(graph.ask(samples=20, seed=4).flows.data) != bytes(response.flows.data)
    graph.until(lambda: len(graph.predictions) == 3, "published predictions")
    assert [p.seed for p in graph.predictions] == [3, 3, 4]
    assert {p.model_id for p in graph.predictions} == {"ambiguous"}


def test_it_says_what_is_wrong(start):
    graph = start()
    empty = graph.ask(np.empty((0, 3), np.float32))
    assert not empty.ok
    assert "too few points" in empty.message
    assert "not finite" in graph.ask(np.full((9, 3), np.nan, np.float32)).message
    assert "allowed: 1..1000" in graph.ask(samples=0).message
    assert graph.asked == [], "a request that is refused needs no truth"
    graph.refusal = "no object"
    assert "refused the cloud: no object" in graph.ask().message


def test_without_a_simulation_it_does_not_hang(start):
    graph = start(bridge=False, truth_timeout=0.3)
    response = graph.ask()
    assert not response.ok
    assert "no answer from sim/ground_truth_flow within 0.3 s" in response.message


def test_an_unknown_oracle_is_refused(start):
    from flowbothd_common.errors import ParameterError

    with pytest.raises(ParameterError, match=r"predictor.*'model'.*oracle, ambiguous"):
        start(predictor="model")
