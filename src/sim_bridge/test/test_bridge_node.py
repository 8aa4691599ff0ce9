"""The bridge as its neighbours see it: topics, services, refusals, holding."""

import time

import numpy as np
import pytest

from flowbothd_common.errors import ObjectModelError, ParameterError
from sim_bridge.params import BridgeParams

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

SMALL = {
    "camera.width": 160,
    "camera.height": 144,
    "camera.fx": 126.0,
    "camera.fy": 126.0,
    "camera.cx": 79.5,
    "camera.cy": 71.5,
    "camera.rate": 10.0,
    "mode": "pull_left",
}


class Graph:
    """A bridge and a neighbour in one process; `messages` holds what the neighbour heard."""

    def __init__(self, **overrides):
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.parameter import Parameter

        from sim_bridge.bridge_node import BridgeNode

        self.context = Context()
        rclpy.init(context=self.context, domain_id=63)
        values = [Parameter(k, value=v) for k, v in {**SMALL, **overrides}.items()]
        self.nodes, self.messages, self._publishers = [], {}, {}
        try:
            self.bridge = BridgeNode(context=self.context, parameter_overrides=values)
            self.nodes.append(self.bridge)
            self.neighbour = Node("neighbour", context=self.context)
            self.nodes.append(self.neighbour)
        except BaseException:
            self.close()
            raise
        self.executor = SingleThreadedExecutor(context=self.context)
        for node in self.nodes:
            self.executor.add_node(node)

    def close(self):
        import rclpy

        for node in self.nodes:
            node.destroy_node()
        rclpy.shutdown(context=self.context)

    def listen(self, kind, topic):
        from flowbothd_common.ros import qos

        heard = self.messages.setdefault(topic, [])
        self.neighbour.create_subscription(kind, topic, heard.append, qos.SENSOR)
        return heard

    def publish(self, message, topic, profile=None):
        from flowbothd_common.ros import qos

        if topic not in self._publishers:
            made = self.neighbour.create_publisher(type(message), topic, profile or qos.COMMAND)
            self._publishers[topic] = made
            self.until(made.get_subscription_count, f"a subscriber of {topic}")
        self._publishers[topic].publish(message)

    def until(self, condition, what, seconds=20.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"{what} did not come within {seconds} s"
            self.executor.spin_once(timeout_sec=0.02)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, kind, name, **fields):
        client = self.neighbour.create_client(kind, name)
        self.until(client.service_is_ready, f"service {name}")
        future = client.call_async(kind.Request(**fields))
        self.until(future.done, f"answer of {name}")
        return future.result()

    def describe(self, text):
        from std_msgs.msg import String

        from flowbothd_common.ros import qos

        self.publish(String(data=text), "robot_description", qos.LATCHED)


@pytest.fixture
def graph():
    """Factory of graphs; everything is gone afterwards."""
    made = []

    def make(**overrides):
        made.append(Graph(**overrides))
        return made[-1]

    yield make
    for item in made:
        item.close()


@pytest.fixture
def running(graph, robot_urdf):
    """A bridge that simulates."""
    from flowbothd_interfaces.msg import SimState

    made = graph()
    heard = made.listen(SimState, "sim/state")
    made.describe(robot_urdf)
    made.until(lambda: heard, "sim/state")
    return made


def cloud(points):
    from std_msgs.msg import Header

    from flowbothd_common.ros.clouds import XYZ, to_cloud_message

    return to_cloud_message(Header(frame_id="panda_link0"), np.asarray(points, np.float32), XYZ)


def trajectory(names, goal, seconds):
    from flowbothd_common.motion import JointTrajectory
    from flowbothd_common.ros.conversions import to_trajectory

    zero = np.zeros((1, len(goal)))
    return to_trajectory(
        JointTrajectory(tuple(names), np.array([seconds]), np.array([goal]), zero, zero)
    )


def test_without_a_robot_it_says_what_it_waits_for(graph):
    from flowbothd_interfaces.msg import Heartbeat
    from flowbothd_interfaces.srv import GroundTruthFlow, ResetSim

    made = graph()
    beats = made.listen(Heartbeat, "heartbeat")
    made.until(lambda: beats, "heartbeat")
    assert not beats[-1].ready
    assert "robot_description" in beats[-1].detail
    answer = made.call(ResetSim, "sim/reset", object="drawer", use_default_pose=True)
    assert not answer.ok
    assert "no world yet" in answer.message
    answer = made.call(GroundTruthFlow, "sim/ground_truth_flow", cloud=cloud([[0, 0, 0]]))
    assert not answer.ok


def test_a_robot_that_cannot_be_used_is_reported_and_a_good_one_still_taken(graph, robot_urdf):
    from flowbothd_interfaces.msg import Heartbeat

    made = graph()
    beats = made.listen(Heartbeat, "heartbeat")
    made.describe("<robot name='r'><link name='base'/></robot>")
    made.until(lambda: beats and "cannot be used" in beats[-1].detail, "the complaint")
    assert "panda_joint1" in beats[-1].detail
    made.describe(robot_urdf)
    made.until(lambda: beats[-1].ready, "a ready heartbeat")


def test_all_topics_come_with_sensible_content(running):
    from geometry_msgs.msg import WrenchStamped
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import CameraInfo, Image, JointState

    from flowbothd_common.ros.conversions import to_seconds
    from flowbothd_interfaces.msg import SuctionMeasurement

    kinds = {
        "/clock": Clock,
        "joint_states": JointState,
        "external_wrench": WrenchStamped,
        "suction/measurement": SuctionMeasurement,
        "depth/image_raw": Image,
        "depth/camera_info": CameraInfo,
    }
    heard = {topic: running.listen(kind, topic) for topic, kind in kinds.items()}
    running.until(lambda: all(heard.values()), "one message on every topic")
    joints, image, info = (
        heard[name][-1] for name in ("joint_states", "depth/image_raw", "depth/camera_info")
    )
    assert joints.name == [f"panda_joint{i}" for i in range(1, 8)]
    assert np.allclose(joints.position, BridgeParams().start, atol=1e-4)
    assert joints.header.frame_id == "panda_link0"
    assert (image.encoding, image.width, image.height, image.step) == ("16UC1", 160, 144, 320)
    assert image.header.frame_id == info.header.frame_id == "depth_camera_link"
    depth = np.frombuffer(image.data, np.uint16)
    assert 300 < depth[depth > 0].min() < depth.max() < 4000
    assert info.k[0] == 126.0
    assert not any(info.d)
    states = running.messages["sim/state"]
    assert states[-1].object == "custom_door"
    assert states[-1].mode == "pull_left"
    assert states[-1].open_ratios.tolist() == [0.0]
    heard["joint_states"].clear()
    running.until(lambda: len(heard["joint_states"]) > 100, "a hundred joint states")
    stamps = np.array([to_seconds(m.header.stamp) for m in heard["joint_states"]])
    assert (np.diff(stamps) > 0).all()
    assert np.median(np.diff(stamps)) == pytest.approx(1 / 120, abs=1e-6)


def test_points_come_only_for_listeners_and_agree_with_the_image(running):
    from sensor_msgs.msg import Image, PointCloud2

    from flowbothd_common.ros.clouds import XYZ, from_cloud_message

    images = running.listen(Image, "depth/image_raw")
    running.until(lambda: images, "an image")
    clouds = running.listen(PointCloud2, "points2")
    running.until(lambda: clouds, "a cloud")
    message = clouds[-1]
    assert (message.width, message.height, message.point_step) == (160, 144, 16)
    stamp = message.header.stamp
    running.until(lambda: any(m.header.stamp == stamp for m in images), "the image of the cloud")
    image = next(m for m in images if m.header.stamp == stamp)
    z = from_cloud_message(message, XYZ)[..., 2]
    millimetres = np.frombuffer(image.data, np.uint16).reshape(144, 160)
    assert np.array_equal(np.isnan(z), millimetres == 0)
    seen = millimetres > 0
    assert np.abs(z[seen] * 1000 - millimetres[seen]).max() < 0.51


def test_trajectories_move_the_arm_and_bad_ones_do_not(running):
    from sensor_msgs.msg import JointState

    joints = running.listen(JointState, "joint_states")
    running.until(lambda: joints, "joint states")
    names, start = joints[-1].name, np.array(joints[-1].position)
    running.publish(trajectory(names[:3], start[:3] + 0.5, 0.3), "joint_trajectory")
    goal = start + 0.1 * np.eye(7)[0]
    running.publish(trajectory(names, goal, 0.3), "joint_trajectory")
    running.until(lambda: np.allclose(joints[-1].position, goal, atol=1e-4), "the goal")


def test_silence_of_the_motion_node_makes_the_arm_hold(running):
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Header

    joints, states = running.listen(JointState, "joint_states"), running.messages["sim/state"]
    running.until(lambda: joints, "joint states")
    start = np.array(joints[-1].position)
    # A beat for half a second, then none: what a killed process looks like.
    for _ in range(10):
        running.publish(Header(), "motion/heartbeat")
        running.spin(0.05)
    assert not states[-1].holding
    far = trajectory(joints[-1].name, start + 1.0 * np.eye(7)[0], 5.0)
    running.publish(far, "joint_trajectory")
    running.until(lambda: states[-1].holding, "holding", seconds=5.0)
    running.until(lambda: np.abs(joints[-1].velocity).max() < 1e-3, "rest", seconds=5.0)
    held = np.array(joints[-1].position)
    assert np.abs(held - start).max() < 0.5
    running.publish(far, "joint_trajectory")
    running.spin(0.3)
    assert np.allclose(joints[-1].position, held, atol=1e-4), "nobody guards this trajectory"
    end = time.monotonic() + 10.0
    while states[-1].holding and time.monotonic() < end:
        running.publish(Header(), "motion/heartbeat")
        running.spin(0.05)
    assert not states[-1].holding


def test_reset_changes_the_object_and_refuses_nonsense(running):
    from geometry_msgs.msg import Pose
    from rosgraph_msgs.msg import Clock

    from flowbothd_common.ros.conversions import to_seconds
    from flowbothd_interfaces.srv import ResetSim

    clocks, states = running.listen(Clock, "/clock"), running.messages["sim/state"]
    running.until(lambda: clocks, "/clock")
    before = to_seconds(clocks[-1].clock)
    bad = running.call(ResetSim, "sim/reset", object="wardrobe", use_default_pose=True)
    assert not bad.ok
    assert "wardrobe" in bad.message
    assert "cabinet_door" in bad.message
    assert (bad.object, bad.mode) == ("custom_door", "pull_left")
    bad = running.call(ResetSim, "sim/reset", object="drawer", pose=Pose())
    assert bad.ok, "an identity pose is a pose"
    pose = Pose()
    pose.orientation.w = 0.0
    bad = running.call(ResetSim, "sim/reset", object="drawer", pose=pose)
    assert not bad.ok
    pose.orientation.w, pose.position.x = 1.0, float("nan")
    bad = running.call(ResetSim, "sim/reset", object="drawer", pose=pose)
    assert not bad.ok
    assert "not finite" in bad.message
    pose.position.x = 0.7
    good = running.call(ResetSim, "sim/reset", object="cabinet_door", mode="left", pose=pose)
    assert good.ok
    assert (good.object, good.mode, good.pose.position.x) == ("cabinet_door", "left", 0.7)
    running.until(lambda: states[-1].object == "cabinet_door", "the new object in sim/state")
    running.until(lambda: to_seconds(clocks[-1].clock) > before, "a clock that goes on")
    stamps = np.array([to_seconds(m.clock) for m in clocks])
    assert (np.diff(stamps) > 0).all(), "time never runs backwards"
    drawn = running.call(ResetSim, "sim/reset", object="custom_door", use_default_pose=True, seed=4)
    again = running.call(ResetSim, "sim/reset", use_default_pose=True, seed=4)
    assert drawn.mode == again.mode
    assert again.object == "custom_door"


def test_ground_truth_is_served_and_bad_clouds_are_refused(running):
    from flowbothd_common.ros.clouds import from_flow_message
    from flowbothd_interfaces.srv import GroundTruthFlow

    # Door edge-on at (0.55, 0): its leaf lies in the plane y = 0.
    points = np.array([[0.55, 0.009, 0.2], [0.60, 0.009, 0.3], [0.0, 0.8, 0.0]])
    answer = running.call(GroundTruthFlow, "sim/ground_truth_flow", cloud=cloud(points))
    assert answer.ok
    same, flows = from_flow_message(answer.flows)
    assert np.allclose(same, points)
    assert flows.shape == (4, 3, 3)
    assert answer.modes[0] == "pull_left"
    assert len(set(answer.modes)) == 4
    assert np.linalg.norm(flows[0], axis=1).max() == pytest.approx(1.0)
    assert not flows[:, 2].any()
    for bad, word in ((np.full((5, 3), np.nan), "not finite"), (np.zeros((0, 3)), "too few")):
        refused = running.call(GroundTruthFlow, "sim/ground_truth_flow", cloud=cloud(bad))
        assert not refused.ok
        assert word in refused.message


def test_the_pump_obeys(running):
    from flowbothd_interfaces.msg import SuctionCommand, SuctionMeasurement

    measured = running.listen(SuctionMeasurement, "suction/measurement")
    running.publish(SuctionCommand(vacuum=60_000.0), "suction/command")
    running.until(lambda: measured and measured[-1].vacuum > 3000, "some vacuum")
    assert not measured[-1].part_present
    assert not measured[-1].in_control_range
    running.publish(SuctionCommand(vacuum=-5.0), "suction/command")
    running.publish(SuctionCommand(vacuum=0.0), "suction/command")
    running.until(lambda: measured[-1].vacuum < 100, "no vacuum")


@pytest.mark.parametrize(
    ("overrides", "error", "words"),
    [
        ({"object": "wardrobe"}, ObjectModelError, "wardrobe"),
        ({"mode": "slide"}, ObjectModelError, "pull_right"),
        ({"target_joint": "knob"}, ObjectModelError, "hinge"),
        ({"camera.rate": 0.0}, ParameterError, "camera.rate"),
        ({"object_position": [1.0, 2.0]}, ParameterError, "3 values"),
        ({"start": [0.0]}, ParameterError, "differ in length"),
    ],
)
def test_bad_parameters_end_the_node_with_a_clear_message(graph, overrides, error, words):
    with pytest.raises(error) as caught:
        graph(**overrides)
    assert words in str(caught.value)
