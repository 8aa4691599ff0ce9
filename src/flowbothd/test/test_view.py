"""Output for people: Rerun files, report pages, shell completion."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

POINTS = np.random.default_rng(0).uniform((0.3, -0.1, 0.0), (0.4, 0.1, 0.4), (200, 3))
POINTS = POINTS.astype(np.float32)


def messages():
    """Topic, type and messages of a short run with one prediction and a decision on it."""
    from geometry_msgs.msg import Point, Vector3, WrenchStamped
    from sensor_msgs.msg import CameraInfo, Image, JointState
    from std_msgs.msg import Header, String

    from flowbothd_common.ros import clouds
    from flowbothd_interfaces.msg import FlowPrediction, PolicyDecision, SuctionState
    from franka_suction_driver.arm.description import compose_urdf

    def header(sec):
        made = Header(frame_id="panda_link0")
        made.stamp.sec = sec
        return made

    flows = np.zeros((2, len(POINTS), 3), np.float32)
    flows[..., 1] = 1.0
    names = [f"panda_joint{i}" for i in range(1, 8)]
    info = CameraInfo(header=header(1), height=12, width=18)
    info.k = [10.0, 0.0, 9.0, 0.0, 10.0, 6.0, 0.0, 0.0, 1.0]
    depth = np.full((12, 18), 800, "<u2")
    image = Image(header=header(1), height=12, width=18, step=36, encoding="16UC1")
    image.data = depth.tobytes()
    event = PolicyDecision(
        header=header(2), decision="approach", state="approaching", reason="good"
    )
    event.prediction_stamp.sec, event.chosen_sample = 1, 1
    event.grasp_point, event.flow = Point(x=0.35, z=0.2), Vector3(y=1.0)
    end = PolicyDecision(
        header=header(4), sequence=1, decision="end", outcome="opened", opening=1.0
    )
    prediction = FlowPrediction(header=header(1), ok=True)
    prediction.flows = clouds.to_flow_message(header(1), POINTS, flows)
    return [
        ("/robot_description", "std_msgs/msg/String", [String(data=compose_urdf())]),
        ("/depth/camera_info", "sensor_msgs/msg/CameraInfo", [info]),
        ("/depth/image_raw", "sensor_msgs/msg/Image", [image]),
        (
            "/joint_states",
            "sensor_msgs/msg/JointState",
            [JointState(header=header(s), name=names, position=[0.1 * s] * 7) for s in (1, 2, 3)],
        ),
        (
            "/object_cloud",
            "sensor_msgs/msg/PointCloud2",
            [clouds.to_cloud_message(header(1), POINTS, clouds.XYZ)],
        ),
        ("/flow/prediction", "flowbothd_interfaces/msg/FlowPrediction", [prediction]),
        ("/policy/decisions", "flowbothd_interfaces/msg/PolicyDecision", [event, end]),
        (
            "/suction/state",
            "flowbothd_interfaces/msg/SuctionState",
            [SuctionState(header=header(2), vacuum=6e4)],
        ),
        (
            "/external_wrench",
            "geometry_msgs/msg/WrenchStamped",
            [WrenchStamped(header=header(2))],
        ),
    ]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    from rclpy.serialization import serialize_message

    from flowbothd_rosbag.metadata import Topic
    from flowbothd_rosbag.writer import BagWriter

    folder = tmp_path_factory.mktemp("view") / "bag"
    writer = BagWriter(folder)
    for name, kind, found in messages():
        writer.add_topic(Topic(name, kind))
        for number, message in enumerate(found):
            stamp = getattr(message, "header", None)
            time = (stamp.stamp.sec if stamp else 0) * 10**9 + number
            writer.write(name, time, serialize_message(message))
    writer.attach(
        "parameters.yaml",
        "application/yaml",
        b"perception_node: {ros__parameters: {camera.position: [0.0, 0.0, 1.0], "
        b"camera.quaternion: [0.0, 0.0, 0.0, 1.0]}}\n",
    )
    writer.close()
    return folder


def test_a_recording_becomes_a_rerun_file_with_everything_in_it(bag, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    from flowbothd.view import entities as at
    from flowbothd.view.view_command import save_bag
    from flowbothd_rosbag.reader import Bag

    file = tmp_path / "run.rrd"
    assert save_bag(Bag(bag), file) == 12
    listing = listed(file)
    for path in (at.CAMERA, at.OBJECT, at.SAMPLES, at.CHOSEN, at.GRASP, at.PATH, at.DECISIONS):
        assert path in listing, path
    for path in (at.OPENING, at.VACUUM, at.FORCE, at.PHASE, f"{at.ROBOT}/panda_link5"):
        assert path in listing, path


def listed(file):
    """Output of `rerun rrd print` for a file."""
    tool = Path(sys.executable).with_name("rerun")
    command = [str(tool), "rrd", "print", str(file)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_rerun_itself_opens_a_recording(bag, tmp_path):
    """Without our view: joint states become curves, clouds become points."""
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    tool, file = Path(sys.executable).with_name("rerun"), tmp_path / "plain.rrd"
    command = [str(tool), "mcap", "convert", str(bag / "bag_0.mcap"), "--output", str(file)]
    subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    listing = listed(file)
    for path in ("/joint_states", "/object_cloud", "/depth/image_raw", "/policy/decisions"):
        assert path in listing, path


def test_a_running_graph_is_shown_as_its_topics_appear(monkeypatch, tmp_path):
    """Live: publishers come after the view, and one is called like ours but is of another type."""
    rr = pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from std_msgs.msg import String

    from flowbothd.view import entities as at
    from flowbothd.view.live_node import LiveView
    from flowbothd_common.ros import qos
    from flowbothd_rosbag.types_ros import message_class

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    file, context = tmp_path / "live.rrd", Context()
    rclpy.init(context=context, domain_id=74)
    recording = rr.RecordingStream("live")
    recording.save(str(file))
    view, graph = LiveView(recording, context=context), Node("graph", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(view)
    shown = []
    monkeypatch.setattr(
        view._view, "show", lambda n, m, show=view._view.show: shown.append(n) or show(n, m)
    )
    try:
        pairs = []
        for name, kind, found in messages():
            publisher = graph.create_publisher(message_class(kind), name, qos.STORY)
            pairs.append((name, publisher, found))
        other = graph.create_publisher(String, "/other/policy/decisions", qos.STORY)
        other.publish(String(data="not ours"))
        deadline = time.monotonic() + 30.0
        while not all(p.get_subscription_count() for _, p, _ in pairs):
            assert time.monotonic() < deadline, "the view does not listen"
            executor.spin_once(timeout_sec=0.05)
        for name, publisher, found in pairs:
            for message in found:
                publisher.publish(message)
            while shown.count(name) < len(found):
                assert time.monotonic() < deadline, f"{name} is not shown"
                executor.spin_once(timeout_sec=0.05)
    finally:
        executor.shutdown()
        view.destroy_node()
        graph.destroy_node()
        rclpy.shutdown(context=context)
    recording.flush()
    recording.disconnect()
    assert "/other/policy/decisions" not in shown
    listing = listed(file)
    for path in (at.OBJECT, at.SAMPLES, at.CHOSEN, at.GRASP, at.PATH, at.DECISIONS, at.VACUUM):
        assert path in listing, path


def test_without_rerun_it_is_said_what_to_do(monkeypatch, bag, capsys):
    from flowbothd.cli import main

    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["view", str(bag), "--save", "x.rrd"]) == 2
    told = capsys.readouterr().err
    assert "pip install rerun-sdk" in told and "flowbothd report" in told


def test_a_report_of_a_real_run_needs_no_world(bag, tmp_path):
    from flowbothd.cli import main

    assert main(["report", str(bag), "--out", str(tmp_path / "page")]) == 0
    page = (tmp_path / "page" / "report.html").read_text()
    assert "opened" in page and "choices.png" in page and "rollout.png" not in page
    assert (tmp_path / "page" / "choices.png").stat().st_size > 5000


def test_the_camera_cloud_lies_where_the_camera_looks():
    from flowbothd.view.camera import STRIDE, thinned_cloud

    found = {name: batch[0] for name, _, batch in messages()}
    pose = np.eye(4)
    pose[:3, 3] = (1.0, 2.0, 3.0)
    points = thinned_cloud(found["/depth/image_raw"], found["/depth/camera_info"], pose)
    assert len(points) == (12 // STRIDE) * (18 // STRIDE)
    np.testing.assert_allclose(points[:, 2], 3.8, atol=1e-6)
    np.testing.assert_allclose(points[0], [1 - 0.9 * 0.8, 2 - 0.6 * 0.8, 3.8], atol=1e-6)


def test_the_tip_moves_with_the_joints():
    from flowbothd.view.robot import RobotPoses
    from franka_suction_driver.arm.description import compose_urdf

    robot = RobotPoses(compose_urdf())
    names = [f"panda_joint{i}" for i in range(1, 8)]
    robot.move(names, [0.0, -0.7, 0.0, -2.2, 0.0, 1.5, 0.7])
    ahead = robot.tip()
    robot.move(["panda_joint1", "another_joint"], [np.pi / 2, 5.0])
    np.testing.assert_allclose(robot.tip(), [-ahead[1], ahead[0], ahead[2]], atol=1e-9)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["re"], {"record", "replay", "report"}),
        (["bench", ""], {"record", "sim", "model"}),
        (["record", "--profile", ""], {"light", "all", "debug"}),
        (["replay", "--rec"], {"--recompute"}),
        (["completion", "z"], {"zsh"}),
    ],
)
def test_bash_completes(words, expected, completion):
    line = " ".join(f"'{word}'" for word in ("flowbothd", *words))
    ask = f"COMP_WORDS=({line}); COMP_CWORD={len(words)}; _flowbothd; echo ${{COMPREPLY[*]}}"
    done = subprocess.run(
        ["bash", "-c", f"source {completion}; {ask}"], capture_output=True, text=True, check=True
    )
    assert expected <= set(done.stdout.split())


@pytest.fixture(scope="module")
def completion(tmp_path_factory):
    from flowbothd.cli import COMMANDS
    from flowbothd.completion import script

    file = tmp_path_factory.mktemp("completion") / "flowbothd"
    file.write_text(script("bash", [(c.name, c.module) for c in COMMANDS]))
    return file
