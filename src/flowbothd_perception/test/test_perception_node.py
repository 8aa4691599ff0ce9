"""The perception node in process: synchronised, in base, and clear about what it misses."""

from __future__ import annotations

import array
import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

DOMAIN = 72
URDF = (
    '<robot name="toy"><link name="base"/><link name="arm"><collision><origin xyz="0 0 0.2"/>'
    '<geometry><cylinder radius="0.05" length="0.4"/></geometry></collision></link>'
    '<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>'
    '<origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>'
)
# At (0.6, 0, 1) looking straight down: x right = base y mirrored, depth 1 m = height 0.
LOOKING_DOWN = {
    "camera.position": [0.6, 0.0, 1.0],
    "camera.quaternion": [1.0, 0.0, 0.0, 0.0],
    "robot.padded_links": ["arm"],
    "robot.paddings": [0.01],
    "sampling.points": 500,
}


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
    nodes = []

    class Ros:
        def add(self, cls, *args, overrides=None):
            parameters = [Parameter(n, value=v) for n, v in (overrides or {}).items()]
            node = cls(*args, context=context, parameter_overrides=parameters)
            executor.add_node(node)
            nodes.append(node)
            return node

        def wait(self, condition, what, seconds=20.0):
            deadline = time.monotonic() + seconds
            while not condition():
                assert time.monotonic() < deadline, f"{what} did not come in {seconds} s"
                executor.spin_once(timeout_sec=0.02)

    yield Ros()
    for node in nodes:
        node.destroy_node()
    executor.shutdown()
    rclpy.shutdown(context=context)


def bench():
    """A node that stands in for robot and camera, and listens."""
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.node import Node
    from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
    from std_msgs.msg import String

    from flowbothd_common.ros import clouds, qos
    from flowbothd_common.ros.conversions import to_stamp

    class Bench(Node):
        def __init__(self, **kwargs):
            super().__init__("bench", **kwargs)
            self.clouds, self.said = [], [(b"\x00", "")]
            self.description = self.create_publisher(String, "robot_description", qos.LATCHED)
            self.joints = self.create_publisher(JointState, "joint_states", qos.STATE)
            self.image = self.create_publisher(Image, "depth/image_raw", qos.IMAGE)
            self.info = self.create_publisher(CameraInfo, "depth/camera_info", qos.IMAGE)
            self.points = self.create_publisher(PointCloud2, "points2", qos.IMAGE)
            self.create_subscription(PointCloud2, "object_cloud", self.clouds.append, qos.IMAGE)
            self.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 10)

        def on_diagnostics(self, message):
            self.said.append((message.status[0].level, message.status[0].message))

        def matched(self):
            publishers = (self.description, self.joints)
            return all(p.get_subscription_count() for p in publishers)

        def send_description(self):
            self.description.publish(String(data=URDF))

        def send_joints(self, stamp, angle=0.0, name="turn"):
            message = JointState(name=[name], position=[angle])
            message.header.stamp = to_stamp(stamp)
            self.joints.publish(message)

        def send_info(self, **changes):
            k = [100.0, 0.0, 49.5, 0.0, 100.0, 39.5, 0.0, 0.0, 1.0]
            self.info.publish(CameraInfo(**{"width": 100, "height": 80, "k": k, **changes}))

        def send_image(self, stamp, depth=0.8, frame=""):
            values = np.full((80, 100), round(1000 * depth), np.uint16)
            message = Image(height=80, width=100, encoding="16UC1", step=200)
            message.data = array.array("B", values.tobytes())
            message.header.stamp = to_stamp(stamp)
            message.header.frame_id = frame
            self.image.publish(message)

        def send_cloud(self, stamp, values):
            from std_msgs.msg import Header

            header = Header(stamp=to_stamp(stamp))
            self.points.publish(clouds.to_cloud_message(header, values, clouds.XYZ))

    return Bench


def start(ros, **overrides):
    from flowbothd_perception.perception_node import PerceptionNode

    other = ros.add(bench())
    ros.add(PerceptionNode, overrides={**LOOKING_DOWN, **overrides})
    ros.wait(other.matched, "matching topics")
    return other


def paced(send, period=0.03):
    """A condition that first sends, but no faster than the other side can listen."""
    last = [0.0]

    def condition():
        if time.monotonic() - last[0] >= period:
            last[0] = time.monotonic()
            send()
        return False

    return condition


def points_of(message):
    from flowbothd_common.ros import clouds

    return clouds.from_cloud_message(message, clouds.XYZ).reshape(-1, 3)


def test_a_frame_becomes_the_object_cloud(ros):
    other = start(ros)
    other.send_description()
    stamps = iter(np.arange(1.0, 1000.0, 0.2))

    def send():
        stamp = float(next(stamps))
        other.send_info()
        other.send_joints(stamp - 0.05)
        other.send_image(stamp)
        other.send_joints(stamp + 0.01, angle=0.0)

    sending = paced(send)
    ros.wait(lambda: sending() or other.clouds, "a cloud")
    message = other.clouds[0]
    assert message.header.frame_id == "panda_link0"
    points = points_of(message)
    assert points.shape == (500, 3)
    np.testing.assert_allclose(points[:, 2], 0.2, atol=1e-3)
    assert abs(points[:, 0].mean() - 0.6) < 0.05


def test_a_frame_waits_for_the_joint_states_of_its_time(ros):
    """At the frame's time the arm lies in view; a moment before it stood upright, outside."""
    other = start(ros)
    other.send_description()
    sending = paced(lambda: (other.send_info(), other.send_joints(1.0)))
    waiting = time.monotonic() + 1.0
    ros.wait(lambda: sending() or time.monotonic() > waiting, "description and lens")
    sending = paced(lambda: (other.send_image(1.05), other.send_joints(1.0)))
    waiting = time.monotonic() + 1.0
    ros.wait(lambda: sending() or time.monotonic() > waiting, "a second of waiting")
    assert not other.clouds, "the frame went out with joint states older than itself"
    other.send_joints(1.049, np.pi / 2)
    other.send_joints(1.06, np.pi / 2)
    ros.wait(lambda: other.clouds, "a cloud")
    points = points_of(other.clouds[0])
    on_axis = (np.abs(points[:, 1]) < 0.05) & (points[:, 0] < 0.4)
    assert not on_axis.any(), "points of the arm that lies in view at the frame's time"


def test_what_is_missing_is_said(ros):
    other = start(ros)
    ros.wait(lambda: any("robot_description" in text for _, text in other.said), "a complaint")
    level, text = other.said[-1]
    assert level == b"\x02"
    for name in ("robot_description", "depth/image_raw", "depth/camera_info"):
        assert name in text
    other.send_description()
    ros.wait(lambda: "joint_states" in other.said[-1][1], "a complaint about joint states")


@pytest.mark.parametrize("case", ["no calibration", "wrong joint", "empty", "nan", "single point"])
def test_bad_input_is_told_and_survived(ros, case):
    cloud_input = case in ("empty", "nan", "single point")
    other = start(ros, **({"input": "cloud"} if cloud_input else {}))
    other.send_description()
    stamps = iter(np.arange(1.0, 1000.0, 0.05))
    values = np.full((9 if case == "nan" else 0, 3), np.nan, np.float32)
    if case == "single point":
        values = np.array([[0.0, 0.0, 0.8]], np.float32)
    expected = {
        "single point": "only 1 of 500 points",
        "no calibration": "no calibration",
        "wrong joint": "joints missing: ['turn']",
    }.get(case, "the camera measured nothing")

    def send():
        stamp = float(next(stamps))
        if cloud_input:
            other.send_cloud(stamp, values)
        else:
            other.send_info(**({"k": [0.0] * 9} if case == "no calibration" else {}))
            other.send_image(stamp)
        other.send_joints(stamp + 0.01, name="elbow" if case == "wrong joint" else "turn")

    sending = paced(send)
    ros.wait(lambda: sending() or any(expected in t for _, t in other.said), f"{expected!r}")
    if cloud_input:
        ros.wait(lambda: other.clouds, "an empty cloud, or one of the point")
        assert points_of(other.clouds[0]).shape == (int(case == "single point"), 3)


@pytest.mark.parametrize("case", ["another frame", "from the past", "from the future", "size"])
def test_frames_that_cannot_be_used_are_told_and_the_next_good_one_is(ros, case):
    wanted = {"camera.frame": "depth_camera_link", "joint_wait": 0.2}
    other = start(ros, **wanted)
    other.send_description()
    stamps = iter(np.arange(100.0, 1000.0, 0.05))
    expected = {
        "another frame": "frame id of the camera; got rgb; allowed: depth_camera_link",
        "from the past": "after the image",
        "from the future": "before the image",
        "size": "differ in size",
    }[case]
    good = [False]

    def send():
        stamp, bad = float(next(stamps)), not good[0]
        other.send_joints(stamp - 0.02)
        other.send_info(**({"width": 50} if bad and case == "size" else {}))
        shift = {"from the past": -50.0, "from the future": 50.0}.get(case, 0.0) if bad else 0.0
        frame = "rgb" if bad and case == "another frame" else "depth_camera_link"
        other.send_image(stamp + shift, frame=frame)
        other.send_joints(stamp + 0.01)

    sending = paced(send)
    ros.wait(lambda: sending() or any(expected in t for _, t in other.said), f"{expected!r}")
    assert not other.clouds
    good[0] = True
    ros.wait(lambda: sending() or other.clouds, "a cloud of a good frame")
    ros.wait(
        lambda: sending() or other.said[-1] == (b"\x00", "publishing object_cloud"),
        "an OK afterwards",
    )


def test_a_camera_that_stalls_is_missed_and_comes_back(ros):
    other = start(ros, image_timeout=0.5)
    other.send_description()
    stamps = iter(np.arange(1.0, 1000.0, 0.05))
    stalled = [False]

    def send():
        stamp = float(next(stamps))
        if not stalled[0]:
            other.send_info()
            other.send_image(stamp)
        other.send_joints(stamp + 0.01)

    sending = paced(send)
    ros.wait(lambda: sending() or other.clouds, "a cloud")
    stalled[0] = True
    ros.wait(lambda: sending() or "missing: depth/image_raw" in other.said[-1][1], "a complaint")
    assert other.said[-1][0] == b"\x02"
    before, stalled[0] = len(other.clouds), False
    ros.wait(lambda: sending() or len(other.clouds) > before, "a cloud after the stall")
    ros.wait(
        lambda: sending() or other.said[-1] == (b"\x00", "publishing object_cloud"),
        "an OK afterwards",
    )


def test_removed_points_and_organised_clouds_are_made_while_somebody_listens(ros):
    from sensor_msgs.msg import PointCloud2

    from flowbothd_common.ros import qos

    other = start(ros)
    got = {}
    for name in ("debug/robot", "debug/outliers", "organised"):
        other.create_subscription(
            PointCloud2,
            f"perception_node/{name}",
            lambda message, name=name: got.__setitem__(name, message),
            qos.IMAGE,
        )
    other.send_description()
    stamps = iter(np.arange(1.0, 1000.0, 0.2))

    def send():
        stamp = float(next(stamps))
        other.send_info()
        other.send_joints(stamp - 0.05, np.pi / 2)
        other.send_image(stamp)
        other.send_joints(stamp + 0.01, np.pi / 2)

    sending = paced(send)
    ros.wait(lambda: sending() or len(got) == 3, "all three clouds")
    whole = got["organised"]
    assert (whole.height, whole.width) == (80, 100)
    points = points_of(whole)
    kept = np.isfinite(points[:, 0])
    robot = points_of(got["debug/robot"])
    assert len(robot) > 100
    assert (np.abs(robot[:, 1]) < 0.08).all()
    # The image shows the plane at height 0.2; every pixel of it is the robot's or the object's.
    assert 500 < kept.sum() <= 8000 - len(robot)
    np.testing.assert_allclose(points[kept][:, 2], 0.2, atol=1e-3)


def test_a_missing_calibration_ends_the_node(ros):
    from flowbothd_common.errors import ParameterError
    from flowbothd_perception.perception_node import PerceptionNode

    with pytest.raises(ParameterError, match=r"camera's pose is not calibrated"):
        ros.add(PerceptionNode)
