"""Writes a recording: mcap file and metadata.yaml, readable at any moment."""

from __future__ import annotations

import time
from pathlib import Path

from flowbothd_rosbag.definitions import definition
from flowbothd_rosbag.mcap_index import McapIndex
from flowbothd_rosbag.mcap_repair import is_complete, repair
from flowbothd_rosbag.mcap_writer import FAST, SMALL, McapWriter
from flowbothd_rosbag.metadata import (
    FILE,
    BagError,
    Metadata,
    Topic,
    parse_qos,
    qos_text,
    read_metadata,
    write_metadata,
)
from flowbothd_rosbag.storage_mcap import McapStorage


class BagWriter:
    """One recording under construction.

    Args:
        folder: New folder.
        chunk_size: Bytes of messages after which they are written.
        period: Seconds after which they are written at the latest.

    Attributes:
        folder: As given.
        full: Why nothing more can be written; empty while all is well.

    Raises:
        BagError: the folder exists, or cannot be made.
    """

    def __init__(
        self, folder: Path, *, chunk_size: int = 4 * 1024 * 1024, period: float = 1.0
    ) -> None:
        self.folder, self._period = folder, period
        try:
            folder.mkdir(parents=True)
            self._file = McapWriter(folder / f"{folder.name}_0.mcap", chunk_size)
        except FileExistsError:
            raise BagError(f"{folder} exists already", hint="name another folder") from None
        except OSError as error:
            raise BagError(f"cannot record into {folder}", got=error.strerror) from error
        self._metadata = Metadata("mcap", [self._file.path.name])
        self._channels: dict[str, int] = {}
        self._counts: dict[int, int] = {}
        self._flushed = time.monotonic()
        self.full = ""
        self._save()

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of the topics so far."""
        return tuple(self._metadata.topics)

    @property
    def size(self) -> int:
        """Bytes in the file so far."""
        return self._file.offset

    @property
    def count(self) -> int:
        """Messages so far."""
        return sum(self._counts.values())

    def add_topic(self, topic: Topic) -> None:
        """Announce a topic; again when more is known of it, which then reaches metadata.yaml."""
        self._metadata.topics[topic.name] = topic
        if topic.name in self._channels:
            return
        about = {
            "offered_qos_profiles": qos_text(topic.qos),
            "topic_type_hash": topic.type_hash,
        }
        with _Guard(self):
            self._channels[topic.name] = self._file.add_channel(
                topic.name, topic.type, definition(topic.type), about, topic.serialization
            )

    def write(
        self, topic: str, received: int, data: bytes, *, sent: int = 0, urgent: bool = False
    ) -> None:
        """Add a message of a topic that was announced.

        Args:
            topic: Its name.
            received: When [ns].
            data: As it came (CDR).
            sent: When it was published [ns]; 0 = unknown.
            urgent: Compress fast rather than well.

        Raises:
            BagError: the disk is full or gone; the recording is readable up to its last second.
        """
        number = self._channels[topic]
        self._file.level = FAST if urgent else SMALL
        with _Guard(self):
            self._file.write(number, received, sent or received, data, self._counts.get(number, 0))
        self._counts[number] = self._counts.get(number, 0) + 1
        self.flush_when_due()

    def flush_when_due(self) -> None:
        """Flush if the last time is longer ago than the period."""
        if time.monotonic() - self._flushed > self._period:
            self.flush()

    def flush(self) -> None:
        """Hand everything so far to the operating system."""
        with _Guard(self):
            self._file.flush()
        self._flushed = time.monotonic()
        self._save()

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Store a file with the messages."""
        with _Guard(self):
            self._file.attach(name, media_type, data, time.time_ns())

    def note(self, name: str, values: dict[str, str]) -> None:
        """Store values, in the file and in the metadata."""
        self._metadata.custom |= {f"{name}.{key}": value for key, value in values.items()}
        with _Guard(self):
            self._file.note(name, values)

    def close(self) -> None:
        """Complete the recording.

        Raises:
            BagError: the disk is so full that not even the index finds room.
        """
        with _Guard(self):
            self._file.close()
        self._save()

    def _save(self) -> None:
        """Bring metadata.yaml up to date with what is in the file."""
        _fill(self._metadata, self._file.index)
        with _Guard(self):
            write_metadata(self.folder, self._metadata)


class _Guard:
    """Turns errors of the disk into a BagError, and lets the writer remember them."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError):
            self._writer.full = error.strerror or str(error)
            raise BagError(
                f"cannot write to {self._writer.folder}",
                got=self._writer.full,
                hint="what was recorded before is kept",
            ) from error


def _fill(metadata: Metadata, index: McapIndex) -> None:
    metadata.start, metadata.end = index.start, index.end
    metadata.counts = {
        channel.topic: index.counts.get(number, 0) for number, channel in index.channels.items()
    }


def recover(folder: Path) -> int:
    """Complete a recording whose writer was killed; one that is complete stays as it is.

    Returns:
        Messages that are in it.

    Raises:
        BagError: there is no mcap file of a recording.
    """
    files = sorted(folder.glob("*.mcap")) if folder.is_dir() else [folder]
    if not files or not files[0].is_file():
        raise BagError(f"{folder} holds no mcap file", hint="sqlite3 recordings need no completion")
    total = 0
    whole = [McapStorage(file) for file in files if is_complete(file)]
    described = folder.is_file() or (folder / FILE).is_file()
    if described and len(whole) == len(files) and all(storage.indexed for storage in whole):
        # Cutting it back to the first damage would only take away from it.
        return sum(sum(storage.counts.values()) for storage in whole)
    for file in files:
        index = repair(file)
        file.with_name(file.name + ".reserve").unlink(missing_ok=True)
        total += sum(index.counts.values())
    if folder.is_dir() and len(files) == 1:
        try:
            metadata = read_metadata(folder)
        except BagError:
            metadata = Metadata("mcap", [files[0].name])
        _fill(metadata, index)
        for channel in index.channels.values():
            metadata.topics.setdefault(
                channel.topic,
                Topic(
                    channel.topic,
                    index.schemas[channel.schema_id].name,
                    parse_qos(channel.metadata.get("offered_qos_profiles", "")),
                    channel.metadata.get("topic_type_hash", ""),
                ),
            )
        write_metadata(folder, metadata)
    return total
