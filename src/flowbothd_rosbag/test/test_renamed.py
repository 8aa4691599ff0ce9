"""Recordings from before topics, types and parameters got the names that they have today."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed")

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from flowbothd_rosbag.attached import stored_parameters
from flowbothd_rosbag.metadata import Topic
from flowbothd_rosbag.reader import Bag, Span
from flowbothd_rosbag.renamed import current_parameters, current_topics
from flowbothd_rosbag.writer import BagWriter

OURS = "flowbothd_interfaces/msg/"
DECISION, EVENT, SUCTION = OURS + "PolicyEvent", OURS + "PolicyInput", OURS + "SuctionState"
OLD_TYPES = {
    DECISION: """
std_msgs/Header header
uint32 sequence
string state
string event
string decision
string reason
uint32 step
uint32 grasps
uint32 trials
builtin_interfaces/Time prediction_stamp
int32 chosen_sample
geometry_msgs/Point grasp_point
geometry_msgs/Vector3 flow
geometry_msgs/Vector3 tool_motion
float64 opening
bool history_updated
bool grasp_switched
string outcome
""",
    # The bounded list of results is left out: it needs a type of ours that was not renamed.
    EVENT: "std_msgs/Header header\nuint32 sequence\nstring event\n",
    SUCTION: """
uint8 OFF=0
uint8 BUILDING=1
uint8 HOLDING=2
uint8 LOST=3
uint8 FAULT=4
std_msgs/Header header
uint8 state
float64 pressure
bool part_present
bool part_detached
bool fault
string message
""",
}


def old_bag(folder: Path, namespace: str = "", storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
    """Write a recording with the old names, definitions and hashes."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for kind, text in OLD_TYPES.items():
        store.register(get_types_from_msg(text, kind))
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=7, nanosec=5)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="panda_link0")
    zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    decision = types[DECISION](
        *(header, 3, "stepping", "motion_result", "step", "", 2, 1, 0, stamp, 4),
        *(types["geometry_msgs/msg/Point"](x=0.5, y=0.25, z=0.125), zero, zero, 0.75),
        *(True, False, ""),
    )
    messages = {
        "/policy/events": (DECISION, decision),
        "/policy/inputs": (EVENT, types[EVENT](header, 9, "cloud")),
        "/suction/state": (SUCTION, types[SUCTION](header, 2, 61000.0, True, False, False, "")),
    }
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        for i, (topic, (kind, message)) in enumerate(messages.items()):
            connection = writer.add_connection(namespace + topic, kind, typestore=store)
            writer.write(connection, 1000 + i, store.serialize_cdr(message, kind))
    return folder


@pytest.mark.parametrize("namespace", ["", "/cell/left"])
@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_an_old_recording_has_the_names_of_today(tmp_path, namespace, storage):
    bag = Bag(old_bag(tmp_path / "bag", namespace, storage))
    assert {t.name.removeprefix(namespace): t.type for t in bag.topics.values()} == {
        "/policy/decisions": OURS + "PolicyDecision",
        "/policy/events": OURS + "PolicyEvent",
        "/suction/state": SUCTION,
    }
    assert set(bag.counts) == set(bag.topics) and set(bag.counts.values()) == {1}
    order = [m.topic.removeprefix(namespace) for m in bag.messages()]
    assert order == ["/policy/decisions", "/policy/events", "/suction/state"]
    only = list(bag.messages([f"{namespace}/policy/events"], Span(0.0, 1.0)))
    assert [m.time for m in only] == [1001]


@pytest.mark.ros
def test_its_messages_are_those_of_the_types_of_today(tmp_path):
    pytest.importorskip("rclpy", reason="ROS is not installed")
    from rclpy.serialization import deserialize_message

    from flowbothd_rosbag.types_ros import message_class

    bag = Bag(old_bag(tmp_path / "bag"))
    read = {
        m.topic: deserialize_message(m.data, message_class(bag.topics[m.topic].type))
        for m in bag.messages(["/policy/decisions", "/suction/state"])
    }
    decision = read["/policy/decisions"]
    assert (decision.sequence, decision.decision, decision.opening) == (3, "step", 0.75)
    assert (decision.grasp_point.z, decision.history_updated) == (0.125, True)
    assert decision.prediction_stamp.sec == 7 and decision.chosen_sample == 4
    assert read["/suction/state"].vacuum == 61000.0 and read["/suction/state"].part_present


@pytest.mark.parametrize("known", ["the other topic", "the hash"])
def test_old_decisions_are_not_taken_for_events(known):
    """A PolicyEvent on `policy/events` is a decision in an old recording, an event in a new one."""
    old = "RIHS01_a83341ea3e61fb131f6d9a59412248ca885be749fe5e22ec05be62fb0b504a41"
    topics = [Topic("/policy/events", DECISION, (), old if known == "the hash" else "")]
    if known == "the other topic":
        topics.append(Topic("/policy/inputs", EVENT))
    found = current_topics(topics)["/policy/events"]
    assert found == Topic("/policy/decisions", OURS + "PolicyDecision")


def test_a_recording_of_today_stays_as_it_is(tmp_path):
    writer = BagWriter(tmp_path / "bag")
    for name, kind in (("decisions", "PolicyDecision"), ("events", "PolicyEvent")):
        writer.add_topic(Topic(f"/policy/{name}", OURS + kind))
    writer.add_topic(Topic("/motion/release", "std_msgs/msg/Empty"))
    writer.close()
    kinds = {t.name: t.type.removeprefix(OURS) for t in Bag(tmp_path / "bag").topics.values()}
    assert kinds == {
        "/policy/decisions": "PolicyDecision",
        "/policy/events": "PolicyEvent",
        "/motion/release": "std_msgs/msg/Empty",
    }


def test_recorded_parameters_get_the_names_and_values_of_today(tmp_path):
    writer = BagWriter(tmp_path / "bag")
    writer.attach(
        "parameters.yaml",
        "application/yaml",
        b"""
cell/perception_node: {ros__parameters: {joint_gap: 0.2, outliers: {neighbours: 9}, seed: 1}}
arm_node: {ros__parameters: {backend: recording, rate: 200.0}}
policy_node: {ros__parameters: {give_arc: false, peers: [motion_node]}}
motion_node: {ros__parameters: {joint_gap: 1.0}}
""",
    )
    writer.close()
    assert stored_parameters(Bag(tmp_path / "bag")) == {
        "perception_node": {"max_gap": 0.2, "outliers.nb_neighbors": 9, "seed": 1},
        "arm_node": {"backend": "mock", "rate": 200.0},
        "policy_node": {"send_joint_estimate": False, "watch_nodes": ["motion_node"]},
        "motion_node": {"joint_gap": 1.0},
    }
    assert current_parameters("pump_node", {"backend": "panda"}) == {"backend": "panda"}
