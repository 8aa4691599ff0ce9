"""Recordings: what is written is read back, by us and by others, whatever happens on the way."""

from __future__ import annotations

import errno
import os
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("mcap", reason="mcap is not installed")

from flowbothd_rosbag.mcap_repair import is_complete
from flowbothd_rosbag.metadata import BagError, Topic, read_metadata
from flowbothd_rosbag.reader import Bag, Span
from flowbothd_rosbag.writer import BagWriter, recover

SECOND = 10**9
QOS = {
    "history": "keep_last",
    "depth": 7,
    "reliability": "best_effort",
    "durability": "transient_local",
    "deadline": {"sec": 9223372036, "nsec": 854775807},
    "lifespan": {"sec": 9223372036, "nsec": 854775807},
    "liveliness": "automatic",
    "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
    "avoid_ros_namespace_conventions": False,
}
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
CHATTER = Topic("/chatter", "std_msgs/msg/String", (QOS,), HASH)
BLOBS = Topic("/blobs", "std_msgs/msg/ByteMultiArray")


def text(words: str) -> bytes:
    """CDR of a std_msgs/String."""
    data = words.encode() + b"\0"
    return b"\x00\x01\x00\x00" + len(data).to_bytes(4, "little") + data


def write(folder, count=50, size=1000, close=True, **options):
    """A recording of two topics; returns its writer and what it should hold."""
    rng = np.random.default_rng(0)
    writer = BagWriter(folder, **options)
    writer.add_topic(CHATTER)
    writer.add_topic(BLOBS)
    expected = []
    for i in range(count):
        topic, data = ("/chatter", text(f"{i}")) if i % 2 else ("/blobs", rng.bytes(size))
        writer.write(topic, (i + 1) * SECOND, data)
        expected.append((topic, (i + 1) * SECOND, data))
    writer.attach("parameters.yaml", "application/yaml", b"a: 1\n")
    writer.note("flowbothd", {"version": "0.1.0"})
    if close:
        writer.close()
    else:
        writer.flush()
    return writer, expected


def test_what_is_written_is_read_back(tmp_path):
    _, expected = write(tmp_path / "bag", chunk_size=4000)
    bag = Bag(tmp_path / "bag")
    assert [tuple(m) for m in bag.messages()] == expected
    assert bag.problems == []
    assert bag.counts == {"/chatter": 25, "/blobs": 25}
    assert bag.topics["/chatter"] == CHATTER
    assert bag.topics["/chatter"].latched and not bag.topics["/chatter"].reliable
    assert bag.attachments() == {"parameters.yaml": b"a: 1\n"}
    assert bag.metadata.custom == {"flowbothd.version": "0.1.0"}
    assert not list((tmp_path / "bag").glob("*.reserve"))


def test_a_span_and_chosen_topics(tmp_path):
    write(tmp_path / "bag", chunk_size=4000)
    bag = Bag(tmp_path / "bag")
    times = [m.time // SECOND for m in bag.messages(["/chatter"], Span(9.5, 14.0))]
    assert times == [12, 14]
    assert next(iter(bag.messages())).time == bag.start() == SECOND


def test_the_mcap_library_reads_it_with_valid_checksums(tmp_path):
    from mcap.reader import make_reader

    write(tmp_path / "bag", chunk_size=4000)
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == 50
        assert reader.get_header().profile == "ros2"
        assert [a.name for a in reader.iter_attachments()] == ["parameters.yaml"]
        assert {m.name for m in reader.iter_metadata()} == {"flowbothd"}


def test_the_rosbags_library_reads_it(tmp_path):
    from rosbags.highlevel import AnyReader

    _, expected = write(tmp_path / "bag", chunk_size=4000)
    with AnyReader([tmp_path / "bag"]) as reader:
        found = [(c.topic, t, bytes(raw)) for c, t, raw in reader.messages()]
        words = [
            reader.deserialize(raw, c.msgtype).data
            for c, _, raw in reader.messages()
            if c.topic == "/chatter"
        ]
    assert found == expected
    assert words[0] == "1"


def structure(value):
    """Names and types of a YAML value, lists by their first element."""
    if isinstance(value, dict):
        return {key: structure(v) for key, v in value.items()}
    if isinstance(value, list):
        return [structure(value[0])] if value else []
    return type(value).__name__


def test_metadata_is_what_rosbag2_of_jazzy_writes(tmp_path):
    """The committed description has every key in the order in which rosbag2 0.26 writes them."""
    writer, _ = write(tmp_path / "bag")
    writer.add_topic(Topic("/blobs", BLOBS.type, (QOS,), HASH))
    writer._save()
    ours = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    described = yaml.safe_load((Path(__file__).parent / "data" / "jazzy_metadata.yaml").read_text())
    ours["rosbag2_bagfile_information"]["custom_data"] = None
    assert structure(ours) == structure(described)
    keys = [list(v["rosbag2_bagfile_information"]) for v in (ours, described)]
    assert keys[0] == keys[1]
    assert ours["rosbag2_bagfile_information"]["version"] == 9


def test_a_killed_writer_leaves_a_readable_recording(tmp_path):
    """SIGKILL comes without warning; what was flushed must be there, and the rest can be mended."""
    script = f"""
import sys
from pathlib import Path
from flowbothd_rosbag.metadata import Topic
from flowbothd_rosbag.writer import BagWriter
writer = BagWriter(Path({str(tmp_path / "bag")!r}))
writer.add_topic(Topic("/chatter", "std_msgs/msg/String"))
for i in range(100):
    writer.write("/chatter", i, b"x" * 100)
writer.flush()
for i in range(100, 120):
    writer.write("/chatter", i, b"x" * 100)
print("ready", flush=True)
sys.stdin.read()
"""
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "ready\n"
    os.kill(process.pid, signal.SIGKILL)
    process.communicate(timeout=30)
    bag = Bag(tmp_path / "bag")
    assert [m.time for m in bag.messages()] == list(range(100))
    assert "was not closed" in bag.problems[0] and "--recover" in bag.problems[0]
    assert read_metadata(tmp_path / "bag").counts == {"/chatter": 100}
    assert recover(tmp_path / "bag") == 100
    assert Bag(tmp_path / "bag").problems == []


@pytest.mark.parametrize("cut", [10, 2000, 20000, -1, -60])
def test_a_recording_cut_off_anywhere_gives_what_comes_before(tmp_path, cut):
    from mcap.reader import make_reader

    _, expected = write(tmp_path / "bag", chunk_size=4000)
    file = tmp_path / "bag" / "bag_0.mcap"
    content = file.read_bytes()
    file.write_bytes(content[: cut if cut > 0 else len(content) + cut])
    bag = Bag(file)
    found = [tuple(m) for m in bag.messages()]
    assert found == expected[: len(found)]
    assert bag.problems
    assert len(found) >= {10: 0, 2000: 0, 20000: 20}.get(cut, len(expected))
    if cut > 10:
        assert recover(tmp_path / "bag") == len(found)
        assert is_complete(file)
        with file.open("rb") as stream:
            again = make_reader(stream).iter_messages()
            assert [(c.topic, m.log_time, m.data) for _, c, m in again] == found
        assert sum(read_metadata(tmp_path / "bag").counts.values()) == len(found)


def test_damage_in_the_middle_ends_the_stream_and_is_named(tmp_path):
    _, expected = write(tmp_path / "bag", chunk_size=4000)
    file = tmp_path / "bag" / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 200] = bytes(200)
    file.write_bytes(content)
    bag = Bag(tmp_path / "bag")
    found = [tuple(m) for m in bag.messages()]
    assert found == expected[: len(found)] and 0 < len(found) < len(expected)
    assert any("damaged" in problem for problem in bag.problems)


def test_a_full_disk_leaves_a_complete_recording(tmp_path):
    """The writer cuts off the chunk that did not fit, and has kept room for the index."""
    writer, expected = write(tmp_path / "bag", chunk_size=4000, close=False)
    file = writer._file._file
    room = file.tell() + 1500

    class FullDisk:
        """Takes what fits, then refuses, as a file on a full disk does."""

        def write(self, data):
            left = max(room - file.tell(), 0)
            if left == 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return file.write(data[:left])

        def __getattr__(self, name):
            return getattr(file, name)

    writer._file._file = FullDisk()
    with pytest.raises(BagError, match="No space left"):
        for i in range(100):
            writer.write("/blobs", 1000 * SECOND + i, np.random.default_rng(i).bytes(1000))
    room = 10**9  # The reserve is given back.
    writer.close()
    bag = Bag(tmp_path / "bag")
    assert bag.problems == []
    assert [tuple(m) for m in bag.messages()][: len(expected)] == expected


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda p: None, "no recording at"),
        (lambda p: p.mkdir(), "neither metadata.yaml nor"),
        (lambda p: (p.mkdir(), (p / "a.mcap").write_bytes(b"")), "not an mcap file"),
        (lambda p: (p.mkdir(), (p / "a.db3").write_bytes(b"junk" * 500)), "not a readable rosbag2"),
        (lambda p: (p.mkdir(), (p / "metadata.yaml").write_text("a: 1")), "is not a recording"),
        (
            lambda p: (
                p.mkdir(),
                (p / "metadata.yaml").write_text(
                    "rosbag2_bagfile_information: {relative_file_paths: [gone.mcap]}"
                ),
            ),
            "has no data file",
        ),
    ],
)
def test_what_is_no_recording_is_refused_with_the_reason(tmp_path, make, said):
    make(tmp_path / "bag")
    with pytest.raises(BagError, match=said):
        Bag(tmp_path / "bag")


def test_an_empty_recording_says_so(tmp_path):
    BagWriter(tmp_path / "bag").close()
    bag = Bag(tmp_path / "bag")
    assert list(bag.messages()) == [] and bag.start() is None
    assert "holds no topics" in bag.problems[0]


def test_an_existing_folder_is_not_overwritten(tmp_path):
    write(tmp_path / "bag")
    with pytest.raises(BagError, match="exists already"):
        BagWriter(tmp_path / "bag")


def old_database(path, *, hashes):
    """A sqlite3 file as rosbag2 wrote it: before Iron without type hashes."""
    with sqlite3.connect(path) as database:
        more = ", type_description_hash TEXT" if hashes else ""
        database.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, "
            f"serialization_format TEXT, offered_qos_profiles TEXT{more})"
        )
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB)"
        )
        old_qos = "- history: 1\n  depth: 7\n  reliability: 2\n  durability: 1"
        row = (1, "/chatter", "std_msgs/msg/String", "cdr", old_qos) + ((HASH,) if hashes else ())
        database.execute(f"INSERT INTO topics VALUES ({', '.join('?' * len(row))})", row)
        for i in (3, 1, 2):
            database.execute("INSERT INTO messages VALUES (?, 1, ?, ?)", (i, i, text(str(i))))
    database.close()


@pytest.mark.parametrize("hashes", [True, False])
def test_sqlite3_recordings_of_every_age_are_read(tmp_path, hashes):
    folder = tmp_path / "bag"
    folder.mkdir()
    old_database(folder / "bag_0.db3", hashes=hashes)
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 4\n  storage_identifier: sqlite3\n"
        "  relative_file_paths: [bag_0.db3]\n  compression_format: ''\n  compression_mode: ''\n"
    )
    bag = Bag(folder)
    assert [m.time for m in bag.messages()] == [1, 2, 3]
    assert bag.topics["/chatter"].latched and not bag.topics["/chatter"].reliable
    assert bag.counts == {"/chatter": 3} and bag.problems == []
    assert Bag(folder / "bag_0.db3").counts == {"/chatter": 3}


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("mode", ["NONE", "FILE", "MESSAGE"])
def test_recordings_of_others_are_read(tmp_path, storage, mode):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    with_options = Writer(
        tmp_path / "bag", version=9, storage_plugin=getattr(StoragePlugin, storage)
    )
    if mode != "NONE":
        with_options.set_compression(getattr(CompressionMode, mode), CompressionFormat.ZSTD)
    with with_options as writer:
        connection = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        for i in range(5):
            writer.write(connection, i, text(str(i)))
    bag = Bag(tmp_path / "bag")
    assert [(m.time, m.data) for m in bag.messages()] == [(i, text(str(i))) for i in range(5)]


def test_definitions_hold_all_that_a_type_is_made_of(monkeypatch):
    import re

    from flowbothd_rosbag.definitions import definition

    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    if not definition("std_msgs/msg/Header"):
        pytest.skip("ROS message definitions are not installed")
    whole = definition("flowbothd_interfaces/msg/FlowPrediction")
    parts = re.findall(r"^MSG: (\S+)$", whole, flags=re.MULTILINE)
    assert {"std_msgs/Header", "sensor_msgs/PointCloud2", "sensor_msgs/PointField"} <= set(parts)
    assert "flowbothd_interfaces/FlowPrediction" not in parts
    assert definition("nobody_msgs/msg/Unknown") == ""


def test_a_service_event_or_an_unknown_type_does_not_close_the_recording_to_others(
    tmp_path, monkeypatch
):
    """`rosbags` refused whole recordings because of one topic of service events."""
    from mcap.reader import make_reader
    from rosbags.highlevel import AnyReader

    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    writer = BagWriter(tmp_path / "bag")
    for name, kind in (
        ("/sim/ground_truth_flow/_service_event", "flowbothd_interfaces/srv/GroundTruthFlow_Event"),
        ("/motion/probe/_action/feedback", "flowbothd_interfaces/action/Probe_FeedbackMessage"),
        ("/strange", "nobody_msgs/msg/Unknown"),
        ("/policy/events", "flowbothd_interfaces/msg/PolicyEvent"),
        ("/chatter", "std_msgs/msg/String"),
    ):
        writer.add_topic(Topic(name, kind, (QOS,)))
        writer.write(name, 1, text("hello"))
    writer.close()
    with AnyReader([tmp_path / "bag"]) as reader:
        assert len(reader.connections) == 5
        chatter = [c for c in reader.connections if c.topic == "/chatter"]
        heard = [reader.deserialize(raw, c.msgtype).data for c, _, raw in reader.messages(chatter)]
    assert heard == ["hello"]
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        schemas = {
            schema.name: schema.encoding for schema, _, _ in make_reader(file).iter_messages()
        }
    assert schemas["nobody_msgs/msg/Unknown"] == "" and schemas["std_msgs/msg/String"] == "ros2msg"
