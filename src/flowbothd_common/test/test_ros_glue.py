"""Conversions, parameters on a real node, signs of life."""

from dataclasses import dataclass

import numpy as np
import pytest

from flowbothd_common.errors import InvalidCloudError, MotionRejectedError, ParameterError
from flowbothd_common.motion import MotionKind, MotionReason, MotionResult
from flowbothd_common.parameters import group, parameter
from flowbothd_common.transforms import rotation_from_rpy, transform
from flowbothd_common.types import History, JointEstimate, JointKind

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros


@dataclass(frozen=True)
class Crop:
    corner: tuple[float, ...] = parameter((0.0, 0.0, 0.0), "corner of the box [m]", length=3)


@dataclass(frozen=True)
class Params:
    rate: float = parameter(5.0, "rate [Hz]", minimum=0.1, maximum=100.0)
    mode: str = parameter("depth", "kind of input", choices=("depth", "cloud"))
    watch: tuple[str, ...] = parameter((), "nodes to watch", element=str)
    crop: Crop = group(Crop)


@pytest.fixture
def make_node():
    """Factory of nodes in an own context and domain; everything is gone afterwards."""
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    context = Context()
    rclpy.init(context=context, domain_id=61)
    nodes = []

    def make(name="probe", **overrides):
        values = [Parameter(k.replace("__", "."), value=v) for k, v in overrides.items()]
        node = Node(name, context=context, parameter_overrides=values)
        nodes.append(node)
        return node

    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown(context=context)


def test_clouds_survive_any_layout():
    from std_msgs.msg import Header

    from flowbothd_common.ros.clouds import XYZ, from_cloud_message, to_cloud_message

    values = np.random.default_rng(1).normal(size=(3, 5, 4)).astype(np.float32)
    message = to_cloud_message(Header(), values, ("y", "pad", "x", "z"))
    assert (message.height, message.width, message.point_step) == (3, 5, 16)
    np.testing.assert_array_equal(from_cloud_message(message, XYZ), values[..., [2, 0, 3]])


@pytest.mark.parametrize("change", ["fields", "data", "endian", "type"])
def test_a_damaged_cloud_is_an_error_and_not_a_crash(change):
    from sensor_msgs.msg import PointField
    from std_msgs.msg import Header

    from flowbothd_common.ros.clouds import XYZ, from_cloud_message, to_cloud_message

    message = to_cloud_message(Header(), np.zeros((7, 3), np.float32), XYZ)
    if change == "fields":
        message.fields = message.fields[:2]
    elif change == "data":
        message.data = message.data[:-1]
    elif change == "endian":
        message.is_bigendian = True
    else:
        message.fields[0].datatype = PointField.FLOAT64
    with pytest.raises(InvalidCloudError):
        from_cloud_message(message, XYZ)


def test_flows_and_history_round_trip():
    from std_msgs.msg import Header

    from flowbothd_common.ros import clouds

    rng = np.random.default_rng(2)
    points = rng.normal(size=(6, 3)).astype(np.float32)
    flows = rng.normal(size=(4, 6, 3)).astype(np.float32)
    message = clouds.to_flow_message(Header(), points, flows)
    assert (message.height, message.width) == (4, 6)
    back = clouds.from_flow_message(message)
    np.testing.assert_array_equal(back[0], points)
    np.testing.assert_array_equal(back[1], flows)
    history = History(points, flows[0])
    again = clouds.from_history_message(clouds.to_history_message(Header(), history))
    np.testing.assert_array_equal(again.flow, history.flow)
    assert clouds.from_history_message(clouds.to_history_message(Header(), None)) is None


def test_results_and_arcs_round_trip():
    from std_msgs.msg import Header

    from flowbothd_common.ros import conversions

    result = MotionResult(
        MotionKind.PROBE,
        MotionReason.VACUUM,
        "held",
        0.4,
        transform(rotation_from_rpy((0.1, 0.2, 0.3)), (1, 2, 3)),
        transform(None, (1, 2, 4)),
        contact=True,
        vacuum=True,
        peak_wrench=np.arange(6.0),
        max_lag=0.01,
        duration=2.0,
    )
    back = conversions.from_result(conversions.to_result(Header(), result))
    np.testing.assert_allclose(back.tool_start, result.tool_start, atol=1e-12)
    np.testing.assert_allclose(back.tool_motion, result.tool_motion)
    assert (back.kind, back.reason, back.vacuum) == (result.kind, result.reason, True)
    joint = JointEstimate(JointKind.REVOLUTE, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    again = conversions.from_joint_estimate(conversions.to_joint_estimate(joint))
    assert again.kind is JointKind.REVOLUTE
    np.testing.assert_array_equal(again.point, joint.point)
    assert conversions.from_joint_estimate(conversions.to_joint_estimate(None)) is None


def test_goals_without_a_direction_are_refused():
    from flowbothd_common.ros.conversions import to_goal
    from flowbothd_interfaces.action import FlowStep

    with pytest.raises(MotionRejectedError, match="direction"):
        to_goal(MotionKind.FLOW_STEP, FlowStep.Goal())
    goal = FlowStep.Goal()
    goal.direction.x, goal.distance = 2.0, -1.0
    with pytest.raises(MotionRejectedError, match="distance"):
        to_goal(MotionKind.FLOW_STEP, goal)


def test_parameters_are_declared_typed_bounded_and_described(make_node):
    from flowbothd_common.ros.parameters import declare

    node = make_node(rate=2.0, crop__corner=[1.0, 2.0, 3.0])
    params = declare(node, Params)
    assert params.rate == 2.0 and params.crop.corner == (1.0, 2.0, 3.0) and params.watch == ()
    assert "Hz" in node.describe_parameter("rate").description


@pytest.mark.parametrize(
    "override", [{"rate": 2}, {"rate": 1e6}, {"mode": "video"}, {"crop__corner": [1.0]}]
)
def test_a_malformed_override_says_what_was_given_and_what_is_allowed(make_node, override):
    from flowbothd_common.ros.parameters import declare

    with pytest.raises(ParameterError) as caught:
        declare(make_node(**override), Params)
    name = next(iter(override))
    assert name.replace("__", ".") in str(caught.value)


def test_a_misspelt_override_is_refused_with_the_nearest_name(make_node):
    from flowbothd_common.ros.parameters import declare, reject_unknown

    node = make_node(rte=2.0)
    declare(node, Params)
    with pytest.raises(ParameterError, match="rate"):
        reject_unknown(node)


def test_silence_is_timed_and_names_who_is_silent():
    from flowbothd_common.ros.liveness import Silence

    silence = Silence(0.5)
    silence.heard("a", now=10.0)
    assert silence.silent(["a", "b"], now=10.2) == ["b"]
    assert silence.silent(["a"], now=10.4) == []
    assert silence.silent(["a"], now=10.6) == ["a"]


def test_a_listener_that_was_stalled_blames_nobody():
    """The incident: a policy that had computed for a second found all five peers dead."""
    from flowbothd_common.ros.liveness import Silence

    silence = Silence(0.5)
    silence.heard("a", now=10.0)
    assert silence.silent(["a"], now=10.1) == []
    assert silence.silent(["a"], now=12.0) == []
    assert silence.silent(["a"], now=12.1) == []
    assert silence.silent(["a"], now=12.3) == ["a"]


def test_a_peer_is_missed_when_it_stops_and_says_what_it_misses_itself(make_node):
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    from flowbothd_common.ros.liveness import HeartbeatPublisher, PeerWatch

    node, peer = make_node("watcher"), make_node("camera")
    watch = PeerWatch(node, ["camera", "arm"], timeout=0.3)
    assert watch.missing()["camera"] == "not heard yet"
    beat = HeartbeatPublisher(peer, period=0.02)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)

    def spin_until(condition):
        deadline = 500
        while not condition() and deadline:
            executor.spin_once(timeout_sec=0.02)
            deadline -= 1
        assert condition(), watch.missing()

    spin_until(lambda: watch.missing().get("camera") == "starting")
    beat.set_ready(True)
    spin_until(lambda: list(watch.missing()) == ["arm"])
    beat.close()
    spin_until(lambda: "silent" in watch.missing().get("camera", ""))
    executor.shutdown()
    assert rclpy.ok(context=node.context)
