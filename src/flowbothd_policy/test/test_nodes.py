"""Inference and policy node in one process, against recording stand-ins for the other nodes.

The runs of the policy are served by an oracle around the door of conftest.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

DOMAIN = 71


@pytest.fixture
def ros(monkeypatch):
    """A context and executor of its own; `add` makes nodes, `wait` spins until a condition."""
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.parameter import Parameter

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    executor = SingleThreadedExecutor(context=context)

    class Ros:
        def __init__(self):
            self.nodes = []

        def add(self, cls, *args, **overrides):
            parameters = [
                Parameter(name.replace("__", "."), value=v) for name, v in overrides.items()
            ]
            node = cls(*args, context=context, parameter_overrides=parameters)
            executor.add_node(node)
            self.nodes.append(node)
            return node

        def wait(self, condition, seconds=20.0, what="the condition"):
            deadline = time.monotonic() + seconds
            while not condition():
                assert time.monotonic() < deadline, f"{what} did not come in {seconds} s"
                executor.spin_once(timeout_sec=0.05)

        def call(self, client, request):
            self.wait(client.service_is_ready, what=client.srv_name)
            future = client.call_async(request)
            self.wait(future.done, what=f"answer of {client.srv_name}")
            return future.result()

    harness = Ros()
    yield harness
    for node in harness.nodes:
        node.destroy_node()
    executor.shutdown()
    rclpy.shutdown(context=context)


def header():
    from std_msgs.msg import Header

    return Header(frame_id="panda_link0")


def fake_world(door):
    """A node that stands in for bridge, perception, motion and suction, around a door."""
    from rclpy.action import ActionServer
    from rclpy.node import Node
    from sensor_msgs.msg import PointCloud2
    from std_srvs.srv import Trigger

    from flowbothd_common.motion import MotionKind
    from flowbothd_common.ros import clouds, qos
    from flowbothd_common.ros.conversions import to_goal, to_result
    from flowbothd_interfaces.action import Approach, FlowStep, Probe, Retreat
    from flowbothd_interfaces.msg import FlowPrediction, Heartbeat, PolicyDecision, SuctionState
    from flowbothd_interfaces.srv import GroundTruthFlow, PredictFlow, SetSuction

    class World(Node):
        def __init__(self, **kwargs):
            super().__init__("world", **kwargs)
            self.door, self.decisions, self.predictions, self.stops = door, [], [], 0
            self.beating = ["perception_node", "motion_node", "suction_node"]
            self.holding, self.suction = False, SuctionState.OFF
            self.heart = self.create_publisher(Heartbeat, "heartbeat", qos.HEARTBEAT)
            self.state = self.create_publisher(SuctionState, "suction/state", qos.STATE)
            self.cloud = self.create_publisher(PointCloud2, "object_cloud", qos.IMAGE)
            self.create_service(GroundTruthFlow, "sim/ground_truth_flow", self.on_truth)
            self.create_service(SetSuction, "suction/set", self.on_suction)
            self.create_service(Trigger, "motion/stop", self.on_stop)
            self.create_subscription(
                PolicyDecision, "policy/decisions", self.decisions.append, qos.EVENT
            )
            self.create_subscription(
                FlowPrediction, "flow/prediction", self.predictions.append, qos.EVENT
            )
            self.predict = self.create_client(PredictFlow, "predict_flow")
            self.start = self.create_client(Trigger, "policy/start")
            self.stop = self.create_client(Trigger, "policy/stop")
            self.actions = [
                ActionServer(self, action, f"motion/{kind.value}", self.motion(kind, action))
                for kind, action in (
                    (MotionKind.APPROACH, Approach),
                    (MotionKind.PROBE, Probe),
                    (MotionKind.FLOW_STEP, FlowStep),
                    (MotionKind.RETREAT, Retreat),
                )
            ]
            self.create_timer(0.05, self.on_timer)

        def on_timer(self):
            for name in self.beating:
                self.heart.publish(Heartbeat(node=name, ready=True))
            self.state.publish(SuctionState(state=self.suction))
            if "perception_node" in self.beating:
                self.publish_cloud(door.observe())

        def publish_cloud(self, points):
            head = header()
            head.stamp = self.get_clock().now().to_msg()
            self.cloud.publish(clouds.to_cloud_message(head, points, clouds.XYZ))

        def motion(self, kind, action):
            def execute(handle):
                result = door.execute(to_goal(kind, handle.request))
                if door.held is not None:
                    self.suction = SuctionState.HOLDING
                handle.succeed()
                answer = action.Result()
                answer.result = to_result(header(), result)
                return answer

            return execute

        def on_suction(self, request, response):
            self.suction = SuctionState.BUILDING if request.vacuum > 0 else SuctionState.OFF
            if request.vacuum == 0:
                door.held = None
            response.success = True
            return response

        def on_stop(self, request, response):
            self.stops += 1
            response.success = True
            return response

        async def on_truth(self, request, response):
            points = clouds.from_cloud_message(request.cloud, clouds.XYZ).reshape(-1, 3)
            truth = door.truth(points)
            response.flows = clouds.to_flow_message(request.cloud.header, points, truth.flows)
            response.modes, response.open_ratio = list(truth.modes), float(truth.open_ratio)
            response.ok = True
            return response

        def destroy_node(self):
            for action in self.actions:
                action.destroy()
            super().destroy_node()

    return World


def ask(points, samples=2):
    from flowbothd_common.ros import clouds
    from flowbothd_interfaces.srv import PredictFlow

    cloud = clouds.to_cloud_message(header(), points, clouds.XYZ)
    return PredictFlow.Request(cloud=cloud, samples=samples, seed=3)


@pytest.mark.long
def test_inference_answers_publishes_and_repeats(ros, make_door):
    pytest.importorskip("torch", reason="torch is not installed")
    from flowbothd_common.ros import clouds
    from flowbothd_policy.inference_node import InferenceNode

    door = make_door("pull_left")
    world = ros.add(fake_world(door))
    ros.add(InferenceNode, model_path="compact-procedural")
    points = door.observe()
    response = ros.call(world.predict, ask(points))
    assert response.ok, response.message
    assert (response.flows.height, response.flows.width) == (2, len(points))
    again = ros.call(world.predict, ask(points))
    assert bytes(again.flows.data) == bytes(response.flows.data)
    ros.wait(lambda: len(world.predictions) == 2, what="published predictions")
    assert world.predictions[0].model_id == response.model_id != ""
    assert world.predictions[0].seed == 3
    back, flows = clouds.from_flow_message(world.predictions[0].flows)
    np.testing.assert_array_equal(back, points)
    np.testing.assert_allclose(np.linalg.norm(flows, axis=2).max(axis=1), 1, rtol=1e-5)
    empty = ros.call(world.predict, ask(np.empty((0, 3), np.float32)))
    assert not empty.ok
    assert "too few points" in empty.message


def test_inference_that_is_not_active_refuses(ros, make_door):
    from flowbothd_policy.inference_node import InferenceNode

    door = make_door("pull_left")
    world = ros.add(fake_world(door))
    ros.add(InferenceNode, autostart=False)
    answer = ros.call(world.predict, ask(door.observe()))
    assert not answer.ok
    assert "activate the lifecycle node" in answer.message


def test_inference_knows_networks_only(ros):
    """The incident: on a robot the inference node could be asked for the truth of a simulation."""
    from flowbothd_common.errors import CheckpointError
    from flowbothd_policy.inference_node import InferenceNode

    node = ros.add(InferenceNode, autostart=False)
    assert list(node.clients) == []
    assert not node.has_parameter("predictor")
    with pytest.raises(CheckpointError, match="set model_path"):
        ros.add(InferenceNode)


def test_a_malformed_parameter_is_refused(ros):
    from flowbothd_common.errors import ParameterError
    from flowbothd_policy.policy_node import PolicyNode

    with pytest.raises(ParameterError, match=r"consistency_angle.*got 'wide'"):
        ros.add(PolicyNode, consistency_angle="wide")


def run_to_outcome(ros, door, **overrides):
    from flowbothd_policy.policy_node import PolicyNode
    from sim_bridge.oracle_node import OracleNode

    world = ros.add(fake_world(door))
    ros.add(OracleNode, predictor="ambiguous")
    ros.add(PolicyNode, **{"seed": 3, "watch_nodes": [*world.beating, "oracle_node"], **overrides})
    return world


def test_the_graph_opens_the_door(ros, make_door):
    from std_srvs.srv import Trigger

    door = make_door("push_right", seed=3)
    world = run_to_outcome(ros, door)
    ros.wait(world.start.service_is_ready)
    early = ros.call(world.start, Trigger.Request())
    if not early.success:
        assert "missing" in early.message
        ros.wait(lambda: ros.call(world.start, Trigger.Request()).success, what="a start")
    again = ros.call(world.start, Trigger.Request())
    assert not again.success
    assert "under way" in again.message
    ros.wait(lambda: world.decisions and world.decisions[-1].outcome, 60.0, "an outcome")
    assert world.decisions[-1].outcome == "opened"
    assert door.open_ratio > 0.9
    assert [decision.sequence for decision in world.decisions] == list(range(len(world.decisions)))


def test_a_silent_node_pauses_the_run_and_is_named(ros, make_door):
    door = make_door("pull_left", limit=1e-9)
    world = run_to_outcome(ros, door, autostart=True, max_recontacts=1000)
    ros.wait(lambda: any(e.state == "observing" for e in world.decisions), 30.0, "a start")
    world.beating.remove("perception_node")
    silent_since = time.monotonic()
    ros.wait(lambda: world.decisions[-1].state == "paused", 5.0, "a pause")
    assert time.monotonic() - silent_since < 1.3, "it is to be noticed within a second"
    assert "perception_node (silent)" in world.decisions[-1].reason
    world.beating.append("perception_node")
    ros.wait(lambda: world.decisions[-1].state != "paused", 10.0, "a resumption")
    assert any(e.decision == "resume" for e in world.decisions)


def test_stop_ends_a_run_and_says_how(ros, make_door):
    from std_srvs.srv import Trigger

    door = make_door("pull_left", limit=1e-9)
    world = run_to_outcome(ros, door, autostart=True, max_recontacts=1000)
    ros.wait(lambda: any(e.decision == "step" for e in world.decisions), 30.0, "a step")
    answer = ros.call(world.stop, Trigger.Request())
    assert answer.success
    assert "policy/stop was called" in answer.message
    ros.wait(lambda: world.decisions[-1].outcome == "aborted", 5.0, "the outcome")
