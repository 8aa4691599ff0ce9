"""`metadata.yaml` of a rosbag2 recording: version 9 is written, as Jazzy does; any is read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from flowbothd_common.errors import FlowBotError
from flowbothd_common.plain_yaml import plain_yaml

VERSION = 9
"""Of the metadata that rosbag2 of Jazzy writes."""

FILE = "metadata.yaml"

QosProfile = dict[str, Any]
"""One offered profile, with the words and the order that rosbag2 writes."""


class BagError(FlowBotError):
    """A recording cannot be read, written or played."""


@dataclass(frozen=True)
class Topic:
    """One topic of a recording.

    Attributes:
        name: With its leading slash.
        type: Such as ``sensor_msgs/msg/Image``.
        qos: Profiles that its publishers offered.
        type_hash: RIHS01 hash of the type, empty if unknown.
        serialization: Of the messages.
    """

    name: str
    type: str
    qos: tuple[QosProfile, ...] = ()
    type_hash: str = ""
    serialization: str = "cdr"

    @property
    def latched(self) -> bool:
        """Whether late joiners were given the last message."""
        return bool(self.qos) and all(_word(q, "durability") == "transient_local" for q in self.qos)

    @property
    def reliable(self) -> bool:
        """Whether every publisher was reliable; unknown counts as reliable."""
        return all(_word(q, "reliability") != "best_effort" for q in self.qos)


@dataclass
class Metadata:
    """What `metadata.yaml` says.

    Attributes:
        storage: mcap or sqlite3.
        files: Names of the data files, in order.
        topics: By name.
        counts: Messages by topic.
        start: Receive time of the first message [ns].
        end: Of the last one [ns].
        custom: Free text values.
        version: Of the file that was read.
        compression: Mode in lower case: empty, file or message.
        distro: ROS distribution that recorded.
    """

    storage: str
    files: list[str]
    topics: dict[str, Topic] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    start: int = 0
    end: int = 0
    custom: dict[str, str] = field(default_factory=dict)
    version: int = VERSION
    compression: str = ""
    distro: str = "jazzy"


# rosbag2 up to version 8 writes the numbers of the C enumerations.
_WORDS: dict[str, dict[object, str]] = {
    "reliability": {1: "reliable", 2: "best_effort"},
    "durability": {1: "transient_local", 2: "volatile"},
}


def _word(profile: Mapping[str, Any], policy: str) -> str:
    value = profile.get(policy, "")
    return _WORDS[policy].get(value, str(value))


def qos_text(profiles: Sequence[QosProfile]) -> str:
    """The profiles as the text that stands in a channel of an mcap file."""
    return plain_yaml(list(profiles)) if profiles else ""


def parse_qos(value: object) -> tuple[QosProfile, ...]:
    """Profiles of a list (version 9) or a text (before); unreadable ones count as none."""
    if isinstance(value, str):
        try:
            value = yaml.safe_load(value)
        except yaml.YAMLError:
            return ()
    entries = value if isinstance(value, list) else []
    return tuple(entry for entry in entries if isinstance(entry, dict))


def write_metadata(folder: Path, metadata: Metadata) -> None:
    """Write `metadata.yaml`, replacing an older one in one move."""
    content = {"rosbag2_bagfile_information": _information(metadata)}
    part = folder / (FILE + ".part")
    part.write_text(plain_yaml(content))
    part.replace(folder / FILE)


def _information(metadata: Metadata) -> dict[str, Any]:
    total = sum(metadata.counts.values())
    starting = {"nanoseconds_since_epoch": metadata.start}
    duration = {"nanoseconds": max(metadata.end - metadata.start, 0)}
    files = [
        {"path": name, "starting_time": starting, "duration": duration, "message_count": total}
        for name in metadata.files[:1]
    ]
    return {
        "version": VERSION,
        "storage_identifier": metadata.storage,
        "duration": duration,
        "starting_time": starting,
        "message_count": total,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": topic.serialization,
                    "offered_qos_profiles": list(topic.qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": metadata.counts.get(topic.name, 0),
            }
            for topic in metadata.topics.values()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": list(metadata.files),
        "files": files,
        "custom_data": metadata.custom or None,
        "ros_distro": metadata.distro,
    }


def read_metadata(folder: Path) -> Metadata:
    """Read `metadata.yaml` of any version.

    Raises:
        BagError: there is none, or it is no rosbag2 metadata.
    """
    path = folder / FILE
    try:
        content = yaml.safe_load(path.read_text())
        information = content["rosbag2_bagfile_information"]
        return _parse(information)
    except FileNotFoundError:
        raise BagError(f"{folder} has no {FILE}") from None
    except (yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise BagError(f"{path} is not the metadata of a rosbag2 recording", got=error) from error


def _parse(information: Mapping[str, Any]) -> Metadata:
    topics, counts = {}, {}
    for entry in information.get("topics_with_message_count") or []:
        about = entry["topic_metadata"]
        topic = Topic(
            about["name"],
            about["type"],
            parse_qos(about.get("offered_qos_profiles")),
            str(about.get("type_description_hash") or ""),
            about.get("serialization_format", "cdr"),
        )
        topics[topic.name] = topic
        counts[topic.name] = int(entry["message_count"])
    start = int((information.get("starting_time") or {}).get("nanoseconds_since_epoch", 0))
    duration = int((information.get("duration") or {}).get("nanoseconds", 0))
    return Metadata(
        storage=str(information.get("storage_identifier", "")),
        files=[str(name) for name in information.get("relative_file_paths") or []],
        topics=topics,
        counts=counts,
        start=start,
        end=start + duration,
        custom={str(k): str(v) for k, v in (information.get("custom_data") or {}).items()},
        version=int(information.get("version", 0)),
        compression=str(information.get("compression_mode") or "").lower().replace("none", ""),
        distro=str(information.get("ros_distro") or ""),
    )
