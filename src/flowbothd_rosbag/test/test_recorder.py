"""The recorder and the player in a graph: nothing is lost, and what cannot be had is named."""

from __future__ import annotations

import itertools
import os
import time

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

_domains = itertools.count(50 + os.getpid() % 40)
WAIT = 20.0


class Bench:
    """Nodes of one test in a domain of its own, spun by hand."""

    def __init__(self):
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor

        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = Context()
        rclpy.init(context=self.context, domain_id=next(_domains))
        self.executor = SingleThreadedExecutor(context=self.context)
        self.nodes = []

    def add(self, node):
        self.executor.add_node(node)
        self.nodes.append(node)
        return node

    def drop(self, node):
        self.executor.remove_node(node)
        self.nodes.remove(node)
        node.destroy_node()

    def wait(self, condition, what):
        end = time.monotonic() + WAIT
        while not condition():
            assert time.monotonic() < end, f"{what} did not come"
            self.executor.spin_once(timeout_sec=0.02)

    def close(self):
        import rclpy

        for node in list(self.nodes):
            self.drop(node)
        self.executor.shutdown(timeout_sec=1.0)
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    made = Bench()
    yield made
    made.close()


def recorder(bench, folder, **values):
    from rclpy.parameter import Parameter

    from flowbothd_rosbag.recorder_node import RecorderNode

    overrides = [Parameter(n, value=v) for n, v in {"out": str(folder), **values}.items()]
    return bench.add(RecorderNode(context=bench.context, parameter_overrides=overrides))


def talker(bench, name="talker"):
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    node = Node(name, context=bench.context)
    node.declare_parameter("camera.position", [1.0, 2.0, 3.0])
    node.declare_parameter("never_set", Parameter.Type.INTEGER)
    return bench.add(node)


def test_every_message_is_recorded_with_offers_hashes_and_parameters(bench, tmp_path):
    """One parameter without a value made rclpy keep back all parameters of its node."""
    import yaml
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import Image, PointCloud2
    from std_msgs.msg import String

    from flowbothd_rosbag.reader import Bag

    node = talker(bench, "perception_node")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    early = node.create_publisher(String, "robot_description", latched)
    early.publish(String(data="<robot/>"))
    pub = node.create_publisher(String, "chatter", 100)
    clouds = node.create_publisher(PointCloud2, "points2", 1)
    colour = node.create_publisher(Image, "rgb/image_raw", 1)
    record = recorder(bench, tmp_path / "bag")
    bench.wait(lambda: pub.get_subscription_count() > 0, "the recorder")
    for i in range(200):
        pub.publish(String(data=str(i)))
        bench.executor.spin_once(timeout_sec=0)
    count = record.recording.counts
    bench.wait(lambda: count["/chatter"] == 200, "all messages")
    bench.wait(lambda: count["/robot_description"] == 1, "the latched message")
    stored = []
    monitor = record.recording.attach
    record.recording.attach = lambda name, *rest: (stored.append(name), monitor(name, *rest))
    bench.wait(lambda: "calibration.yaml" in stored, "parameters of the nodes")
    assert clouds.get_subscription_count() == 0, "a light recording asks for no camera clouds"
    assert colour.get_subscription_count() == 0
    bench.drop(record)

    bag = Bag(tmp_path / "bag")
    assert bag.problems == []
    words = [m.data[8:-1].decode().rstrip("\0") for m in bag.messages(["/chatter"])]
    assert words == [str(i) for i in range(200)]
    assert bag.topics["/robot_description"].latched
    offered = bag.topics["/chatter"].qos[0]
    assert offered["reliability"] == "reliable" and offered["durability"] == "volatile"
    assert bag.topics["/chatter"].type_hash.startswith("RIHS01_df668c74")
    files = bag.attachments()
    parameters = yaml.safe_load(files["parameters.yaml"])
    assert parameters["perception_node"]["ros__parameters"]["camera.position"] == [1.0, 2.0, 3.0]
    assert "never_set" not in parameters["perception_node"]["ros__parameters"]
    assert yaml.safe_load(files["calibration.yaml"]) == {
        "perception_node": {"camera.position": [1.0, 2.0, 3.0]}
    }
    assert files["robot_description.urdf"] == b"<robot/>"
    assert "flowbothd" in yaml.safe_load(files["versions.yaml"])


def test_messages_beyond_the_memory_are_dropped_counted_and_named(tmp_path):
    from flowbothd_rosbag.metadata import Topic
    from flowbothd_rosbag.recording import Recording
    from flowbothd_rosbag.writer import BagWriter

    recording = Recording(BagWriter(tmp_path / "bag"), limit=1000)
    recording.add_topic(Topic("/blobs", "std_msgs/msg/ByteMultiArray"))
    recording.take("/blobs", 1, 0, bytes(5000))
    recording.take("/blobs", 2, 0, bytes(500))
    recording.close()
    assert dict(recording.dropped) == {"/blobs": 1}
    assert dict(recording.counts) == {"/blobs": 1}


def write_bag(folder, *, clock=False):
    from rclpy.serialization import serialize_message
    from rosgraph_msgs.msg import Clock
    from std_msgs.msg import String

    from flowbothd_rosbag.metadata import Topic
    from flowbothd_rosbag.writer import BagWriter

    latched = {"reliability": "reliable", "durability": "transient_local"}
    writer = BagWriter(folder)
    writer.add_topic(Topic("/robot_description", "std_msgs/msg/String", (latched,)))
    writer.add_topic(Topic("/chatter", "std_msgs/msg/String"))
    writer.add_topic(Topic("/strange", "nobody_msgs/msg/Unknown"))
    start = 100 * 10**9
    writer.write("/robot_description", start, serialize_message(String(data="<robot/>")))
    writer.write("/strange", start, b"\0\1\0\0")
    if clock:
        writer.add_topic(Topic("/clock", "rosgraph_msgs/msg/Clock"))
    for i in range(50):
        now = start + i * 10**7
        if clock:
            stamp = Clock()
            stamp.clock.sec = 7
            writer.write("/clock", now, serialize_message(stamp))
        writer.write("/chatter", now, serialize_message(String(data=str(i))))
    writer.close()
    return folder


class Ear:
    """Hears what is played."""

    def __init__(self, bench):
        from rclpy.node import Node
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from rosgraph_msgs.msg import Clock
        from std_msgs.msg import String

        self.words, self.times, self.robots = [], [], []
        node = bench.add(Node("ear", context=bench.context))
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(String, "chatter", lambda m: self.words.append(m.data), 100)
        node.create_subscription(Clock, "/clock", lambda m: self.times.append(m.clock), 100)
        node.create_subscription(
            String, "robot_description", lambda m: self.robots.append(m.data), latched
        )


def play(bench, folder, **values):
    from rclpy.parameter import Parameter

    from flowbothd_rosbag.player_node import Ended, PlayerNode

    values = {"bag": str(folder), "delay": 0.0, "wait_for": ["/chatter"], **values}
    overrides = [Parameter(n, value=v) for n, v in values.items()]
    player = bench.add(PlayerNode(context=bench.context, parameter_overrides=overrides))
    with pytest.raises(Ended):
        bench.wait(lambda: False, "the end of the recording")
    return player


def test_a_recording_without_clock_is_played_on_the_time_of_its_messages(bench, tmp_path):
    ear = Ear(bench)
    player = play(bench, write_bag(tmp_path / "bag"), rate=2.0)
    bench.wait(lambda: len(ear.words) == 50, "all messages")
    assert ear.words == [str(i) for i in range(50)]
    assert ear.robots == ["<robot/>"]
    assert ear.times and all(99 < t.sec < 102 for t in ear.times)
    assert player.played == 51


def test_a_recorded_clock_is_played_and_none_made(bench, tmp_path):
    ear = Ear(bench)
    play(bench, write_bag(tmp_path / "bag", clock=True))
    bench.wait(lambda: len(ear.times) == 50, "the recorded clock")
    assert {t.sec for t in ear.times} == {7}


def test_a_part_begins_with_what_late_joiners_get(bench, tmp_path):
    """From the middle on, nobody would tell perception what the robot looks like."""
    ear = Ear(bench)
    play(bench, write_bag(tmp_path / "bag"), begin=0.2, end=0.3)
    bench.wait(lambda: ear.robots and len(ear.words) == 11, "the part")
    assert ear.words == [str(i) for i in range(20, 31)]


def test_types_that_are_not_installed_are_named_and_the_rest_is_played(bench, tmp_path):
    from rclpy.parameter import Parameter

    from flowbothd_rosbag.player_node import PlayerNode

    said = []

    class Telling(PlayerNode):
        def _tell(self, text):
            said.append(text)

    folder = write_bag(tmp_path / "bag")
    overrides = [Parameter("bag", value=str(folder))]
    bench.add(Telling(context=bench.context, parameter_overrides=overrides))
    assert any("/strange" in t and "nobody_msgs/msg/Unknown is not installed" in t for t in said)
    assert any("no /clock in it" in t for t in said)


def test_a_recording_with_nothing_to_play_is_refused(bench, tmp_path):
    from rclpy.parameter import Parameter

    from flowbothd_rosbag.metadata import BagError, Topic
    from flowbothd_rosbag.player_node import PlayerNode
    from flowbothd_rosbag.writer import BagWriter

    writer = BagWriter(tmp_path / "bag")
    writer.add_topic(Topic("/strange", "nobody_msgs/msg/Unknown"))
    writer.close()
    overrides = [Parameter("bag", value=str(tmp_path / "bag"))]
    with pytest.raises(BagError, match="can be played"):
        PlayerNode(context=bench.context, parameter_overrides=overrides)


def test_an_error_of_the_source_comes_after_the_items_before_it():
    from flowbothd_rosbag.prefetch import prefetched

    def source():
        yield from range(3)
        raise ValueError("the disk is gone")

    items = prefetched(source())
    assert [next(items) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="disk is gone"):
        next(items)
    assert list(prefetched(iter(()))) == []


def test_profiles_take_what_they_promise():
    from flowbothd_rosbag.recorder_params import RecorderParams, wanted

    topics = {
        "/depth/image_raw": "sensor_msgs/msg/Image",
        "/object_cloud": "sensor_msgs/msg/PointCloud2",
        "/policy/events": "flowbothd_interfaces/msg/PolicyEvent",
        "/points2": "sensor_msgs/msg/PointCloud2",
        "/rgb/image_raw": "sensor_msgs/msg/Image",
        "/perception_node/debug/robot": "sensor_msgs/msg/PointCloud2",
    }

    def taken(**values):
        return [n for n, kind in topics.items() if wanted(n, kind, RecorderParams(**values))]

    assert taken(profile="light") == list(topics)[:3]
    assert taken(profile="all") == list(topics)[:5]
    assert taken(profile="debug") == list(topics)
    assert taken(profile="debug", exclude="points2|rgb") == [
        n for n in topics if "points2" not in n and "rgb" not in n
    ]
