"""Recordings of graphs in namespaces: found by the end of the name, one graph at a time."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mcap", reason="mcap is not installed")

from flowbothd_rosbag.lookup import by_node, graph_namespace, topic_called
from flowbothd_rosbag.metadata import BagError, Topic
from flowbothd_rosbag.reader import Bag
from flowbothd_rosbag.writer import BagWriter

DECISIONS = ("policy/decisions", "flowbothd_interfaces/msg/PolicyDecision")
JOINTS = ("joint_states", "sensor_msgs/msg/JointState")


def recording(folder: Path, *topics: tuple[str, str]) -> Path:
    """Writes a recording without messages; gives its path."""
    writer = BagWriter(folder / "bag")
    for name, kind in topics:
        writer.add_topic(Topic(name, kind))
    writer.close()
    return folder / "bag"


def below(namespace: str, *topics: tuple[str, str]) -> list[tuple[str, str]]:
    return [(f"{namespace}/{name}", kind) for name, kind in topics]


@pytest.mark.parametrize("namespace", ["", "/left", "/cell/left"])
def test_topics_are_found_wherever_the_graph_lived(tmp_path: Path, namespace: str):
    """A gripper's joint states were taken for a second arm's, and the recording refused."""
    gripper = below(f"{namespace}/gripper", JOINTS)
    bag = Bag(recording(tmp_path, *below(namespace, DECISIONS, JOINTS), *gripper))
    assert graph_namespace(bag) == namespace
    assert topic_called(bag, *JOINTS) == f"{namespace}/joint_states"
    assert topic_called(bag, *DECISIONS) == f"{namespace}/policy/decisions"
    assert topic_called(bag, "policy/decisions", "std_msgs/msg/String") is None
    assert topic_called(bag, "sim/state") is None


def test_what_a_driver_publishes_outside_the_namespace_is_found_too(tmp_path: Path):
    bag = Bag(recording(tmp_path, *below("/left", DECISIONS), *below("", JOINTS)))
    assert topic_called(bag, *JOINTS) == "/joint_states"


def test_of_two_graphs_one_has_to_be_chosen(tmp_path: Path):
    path = recording(
        tmp_path,
        *below("/left", DECISIONS, JOINTS),
        *below("/right", DECISIONS, ("sim/state", "flowbothd_interfaces/msg/SimState")),
    )
    with pytest.raises(BagError, match=r"several graphs; got /left, /right; .*--namespace /right"):
        topic_called(Bag(path), *DECISIONS)
    for given in ("left", "/left", "left/"):
        assert topic_called(Bag(path, given), *DECISIONS) == "/left/policy/decisions"
    assert topic_called(Bag(path, "left"), "sim/state") is None, "that is the right one's"
    assert topic_called(Bag(path, "right"), "sim/state") == "/right/sim/state"
    with pytest.raises(BagError, match="got /middle; allowed: /left, /right"):
        topic_called(Bag(path, "middle"), *DECISIONS)


def test_a_graph_in_the_root_can_be_chosen(tmp_path: Path):
    bag = Bag(recording(tmp_path, *below("", DECISIONS), *below("/left", DECISIONS, JOINTS)), "/")
    assert topic_called(bag, *DECISIONS) == "/policy/decisions"
    assert topic_called(bag, *JOINTS) is None


def test_without_a_graph_of_ours_two_topics_of_one_name_are_an_error(tmp_path: Path):
    path = recording(tmp_path, *below("/a", JOINTS), *below("/b", JOINTS))
    with pytest.raises(BagError, match=r"several topics called joint_states; got /a/.*, /b/"):
        topic_called(Bag(path), *JOINTS)
    assert topic_called(Bag(path, "b"), *JOINTS) == "/b/joint_states"


def test_values_are_those_of_the_graph_s_nodes(tmp_path: Path):
    """Of two perception_nodes the one that came last gave the camera's pose for both."""
    values = {"left/perception_node": 1, "right/perception_node": 2, "talker": 3}
    path = recording(tmp_path, *below("/left", DECISIONS), *below("/right", DECISIONS))
    assert by_node(Bag(path, "left"), values) == {"perception_node": 1, "talker": 3}
    assert by_node(Bag(path, "/right"), values) == {"perception_node": 2, "talker": 3}
    with pytest.raises(BagError, match="/left, /right"):
        by_node(Bag(path), values)
    assert by_node(Bag(path), {"/**/motion_node": 4, "/left/arm_node": 5}) == {
        "motion_node": 4,
        "arm_node": 5,
    }
