"""Recordings of a graph in a namespace, replayed and computed again."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mcap", reason="mcap is not installed")
pytest.importorskip("rclpy", reason="ROS is not installed")

from flowbothd.replay.perception_run import perceive_again
from flowbothd.replay.story import read_story
from flowbothd_bringup.replay_graph import PERCEPTION, PLAYER, playing_graph
from flowbothd_rosbag.metadata import BagError, Topic
from flowbothd_rosbag.reader import Bag
from flowbothd_rosbag.writer import BagWriter

DECISIONS = ("policy/decisions", "flowbothd_interfaces/msg/PolicyDecision")
SENSED = (
    ("joint_states", "sensor_msgs/msg/JointState"),
    ("robot_description", "std_msgs/msg/String"),
    ("depth/image_raw", "sensor_msgs/msg/Image"),
    ("depth/camera_info", "sensor_msgs/msg/CameraInfo"),
)
PARAMETERS = """
left/perception_node:
  ros__parameters: {camera.position: [0.0, 0.0, 1.0], camera.quaternion: [0.0, 0.0, 0.0, 1.0]}
"""


def recording(folder: Path, *topics: tuple[str, str]) -> Path:
    """Writes a recording of a graph in /left, without messages; gives its path."""
    writer = BagWriter(folder / "bag")
    for name, kind in topics:
        writer.add_topic(Topic(f"/left/{name}", kind))
    writer.attach("parameters.yaml", "application/yaml", PARAMETERS.encode())
    writer.close()
    return folder / "bag"


@pytest.mark.ros
def test_perception_runs_again_on_a_recording_from_a_namespace(tmp_path: Path):
    """The incident: `replay --recompute perception` lacked /joint_states, recorded under /left."""
    path = recording(tmp_path, DECISIONS, *SENSED)
    assert perceive_again(Bag(path), read_story(Bag(path))).clouds == {}
    lacking = Bag(recording(tmp_path / "less", DECISIONS))
    with pytest.raises(BagError, match="lacks what perception_node listens to"):
        perceive_again(lacking, read_story(lacking))


def test_perception_is_started_with_what_it_had_in_its_namespace(tmp_path: Path):
    path = recording(tmp_path, DECISIONS, *SENSED)
    graph = playing_graph(path, perception=True)
    assert graph.parameters[PERCEPTION]["camera.position"] == [0.0, 0.0, 1.0]
    assert graph.parameters[PLAYER]["wait_for"] == ["/left/joint_states", "/left/depth/image_raw"]


def test_perception_listens_where_the_graph_was_and_the_player_stays_in_the_root(tmp_path: Path):
    """The incident: perception_node listened in the root to a recording from /left, and waited."""
    path = recording(tmp_path, DECISIONS, *SENSED)
    processes = playing_graph(path, perception=True).processes(tmp_path / "parameters.yaml")
    moved = {process.name: "__ns:=/left" in process.command for process in processes}
    assert moved == {PLAYER: False, PERCEPTION: True}
    assert playing_graph(path).namespace == ""
