"""Recordings that are cut off, foreign, or lie about themselves: read as far as they go."""

from __future__ import annotations

import pytest

pytest.importorskip("mcap", reason="mcap is not installed")

from flowbothd_rosbag.metadata import BagError, Topic
from flowbothd_rosbag.reader import Bag
from flowbothd_rosbag.writer import BagWriter, recover


def text(words: str) -> bytes:
    """CDR of a std_msgs/String."""
    data = words.encode() + b"\0"
    return b"\x00\x01\x00\x00" + len(data).to_bytes(4, "little") + data


def chatter(folder, names=("/chatter",), kind="std_msgs/msg/String", count=3, attach=()):
    """A recording of the same words on some topics."""
    writer = BagWriter(folder, chunk_size=4000)
    for name in names:
        writer.add_topic(Topic(name, kind))
        for i in range(count):
            writer.write(name, i + 1, text(f"{i} " + "x" * 100))
    for name, content in attach:
        writer.attach(name, "application/yaml", content)
    writer.close()
    return folder


@pytest.mark.parametrize(
    "content",
    [
        "hello",
        "rosbag2_bagfile_information: hello",
        "rosbag2_bagfile_information: [1, 2]",
        "rosbag2_bagfile_information: {starting_time: 5}",
        "rosbag2_bagfile_information: {custom_data: [a]}",
        "rosbag2_bagfile_information: {relative_file_paths: 7}",
        "rosbag2_bagfile_information: {topics_with_message_count: [{topic_metadata: a}]}",
        "a: [",
    ],
)
def test_metadata_of_any_kind_of_nonsense_is_named_and_the_file_is_read(tmp_path, content):
    folder = chatter(tmp_path / "bag")
    (folder / "metadata.yaml").write_text(content)
    bag = Bag(folder)
    assert bag.counts == {"/chatter": 3}
    assert "is not the metadata of a rosbag2 recording" in bag.problems[0]


@pytest.mark.parametrize("version", [2, 4, 5, 6, 7, 8, 9])
def test_metadata_of_every_version_is_read(tmp_path, version):
    """Before 9 profiles are a text of numbers, before 7 no hashes, before 5 no files."""
    from flowbothd_rosbag.metadata import read_metadata

    profile = {"history": 1, "depth": 7, "reliability": 2, "durability": 1}
    about = {"name": "/a", "type": "std_msgs/msg/String", "serialization_format": "cdr"}
    if version >= 4:
        profiles = "- " + "\n  ".join(f"{k}: {v}" for k, v in profile.items())
        about["offered_qos_profiles"] = profiles if version < 9 else [profile]
    if version >= 7:
        about["type_description_hash"] = "RIHS01_0"
    information = {
        "version": version,
        "storage_identifier": "sqlite3",
        "relative_file_paths": ["a.db3"],
        "duration": {"nanoseconds": 5},
        "starting_time": {"nanoseconds_since_epoch": 7},
        "message_count": 1,
        "topics_with_message_count": [{"topic_metadata": about, "message_count": 1}],
    }
    if version >= 5:
        information |= {"files": [], "compression_format": "", "compression_mode": "NONE"}
    import yaml

    (tmp_path / "metadata.yaml").write_text(
        yaml.safe_dump({"rosbag2_bagfile_information": information})
    )
    found = read_metadata(tmp_path)
    assert (found.version, found.start, found.end, found.compression) == (version, 7, 12, "")
    assert found.counts == {"/a": 1}
    assert found.topics["/a"].latched == (version >= 4)
    assert found.topics["/a"].reliable == (version < 4)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_a_database_that_is_cut_off_gives_what_comes_before(tmp_path, share):
    """Of a file that is a page too short sqlite reads nothing: a cut copy was lost as a whole."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        for i in range(2000):
            writer.write(connection, i, text(f"{i} " + "x" * 400))
    file = tmp_path / "bag" / "bag.db3"
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    bag = Bag(tmp_path / "bag")
    times = [m.time for m in bag.messages()]
    assert times == list(range(len(times)))
    assert 2000 * share * 0.7 < len(times) <= 2000
    assert bag.counts["/chatter"] == len(times)
    assert len(bag.problems) == 1 and "is cut off" in bag.problems[0]
    assert file.stat().st_size == int(share * len(content)), "the file itself stays as it is"


def test_completing_takes_nothing_from_a_recording_that_is_complete(tmp_path):
    """`record --recover` cut a closed recording back to a damaged chunk in its middle."""
    folder = chatter(tmp_path / "bag", count=200)
    file = folder / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0xFF
    file.write_bytes(content)
    assert recover(folder) == 200
    assert file.read_bytes() == content


def test_messages_outside_of_chunks_are_read_and_not_completed(tmp_path):
    """The index that completing writes names chunks only: such a file would have become empty."""
    from mcap.writer import IndexType, Writer

    file = tmp_path / "a.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, index_types=IndexType.NONE, use_chunking=False)
        writer.start("ros2", "somebody")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        for time in (1, 2, 3):
            writer.add_message(channel, time, text("a"), time)
        stream.flush()
        whole = file.read_bytes()
    file.write_bytes(whole)
    assert [m.time for m in Bag(file).messages()] == [1, 2, 3]
    with pytest.raises(BagError, match="outside of chunks"):
        recover(file)
    assert file.read_bytes() == whole
