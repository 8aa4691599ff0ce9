"""Reads rosbag2 recordings: mcap and sqlite3, complete or cut off, of any version."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import zstandard

from flowbothd_rosbag.metadata import FILE, BagError, Metadata, Topic, read_metadata
from flowbothd_rosbag.renamed import current_topics
from flowbothd_rosbag.storage_mcap import McapStorage
from flowbothd_rosbag.storage_sqlite3 import SqliteStorage
from flowbothd_rosbag.unpack import unpacked


class Message(NamedTuple):
    """One message of a recording.

    Attributes:
        topic: Its name.
        time: When it was received [ns].
        data: As it was sent (CDR).
    """

    topic: str
    time: int
    data: bytes


class Storage(Protocol):
    """One data file of a recording.

    Attributes:
        topics: By name.
        problems: What is wrong with it, for people.
    """

    topics: dict[str, Topic]
    problems: list[str]

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic; reads everything where no index says it."""
        ...

    def messages(self, topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, receive time [ns] and content of every message of the topics, in time order."""
        ...

    def attachments(self) -> dict[str, bytes]:
        """Files within, by name."""
        ...


_STORAGES: dict[str, Callable[[Path], Storage]] = {".mcap": McapStorage, ".db3": SqliteStorage}


@dataclass(frozen=True)
class Span:
    """A part of a recording.

    Attributes:
        begin: Seconds after its first message.
        end: The same; None = its end.
    """

    begin: float = 0.0
    end: float | None = None


class Bag:
    """A recording that can be read.

    Args:
        path: Folder of the recording, or one of its files.
        namespace: Graph to look at where several were recorded; None = the only one.

    Attributes:
        path: As given.
        namespace: As given.
        metadata: From metadata.yaml, or made from the files where there is none.
        topics: By name; names and types are those of today, also in an older recording.

    Raises:
        BagError: there is nothing at the path that could be a recording.
    """

    def __init__(self, path: Path, namespace: str | None = None) -> None:
        self.path, self.namespace = path, namespace
        self._problems: list[str] = []
        self.metadata, files = _look(path, self._problems)
        self._storages = [self._open(file) for file in files]
        stored = dict(self.metadata.topics)
        for storage in self._storages:
            # The file knows its own topics better than a metadata.yaml written before the end.
            stored |= {t.name: self._richer(t) for t in storage.topics.values()}
        current = current_topics(stored.values())
        self.topics = {topic.name: topic for topic in current.values()}
        self._names = {name: topic.name for name, topic in current.items()}
        if not self.topics:
            self._problems.append(f"{path} holds no topics: the recording is empty")

    @property
    def problems(self) -> list[str]:
        """What is wrong with the recording, for people; grows while damaged parts are read."""
        return [*self._problems, *(text for s in self._storages for text in s.problems)]

    def _richer(self, topic: Topic) -> Topic:
        known = self.metadata.topics.get(topic.name)
        if known is None or topic.qos:
            return topic
        return Topic(topic.name, topic.type, known.qos, known.type_hash, topic.serialization)

    def _open(self, file: Path) -> Storage:
        suffixes = [s for s in file.suffixes if s in _STORAGES]
        if not suffixes:
            raise BagError(
                f"{file} is of an unknown format", got=file.suffix, allowed=", ".join(_STORAGES)
            )
        return _STORAGES[suffixes[-1]](unpacked(file, self._problems))

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic; reads everything where no index says it."""
        result: dict[str, int] = dict.fromkeys(self.topics, 0)
        for storage in self._storages:
            for name, count in storage.counts.items():
                result[self._names[name]] += count
        return result

    def start(self) -> int | None:
        """Receive time of the first message [ns]; None if there is none."""
        for message in self.messages():
            return message.time
        return None

    def messages(
        self, topics: Iterable[str] | None = None, span: Span | None = None
    ) -> Iterator[Message]:
        """Messages in the order in which they were received.

        Args:
            topics: Names; all if omitted.
            span: Part to read; all if omitted.
        """
        asked = self.topics if topics is None else frozenset(topics)
        wanted = frozenset(name for name, current in self._names.items() if current in asked)
        streams = [storage.messages(wanted) for storage in self._storages]
        merged = heapq.merge(*streams, key=lambda entry: entry[1])
        if span is None or (span.begin <= 0 and span.end is None):
            yield from (self._message(*entry) for entry in merged)
            return
        start = self.start()
        if start is None:
            return
        begin = start + round(span.begin * 1e9)
        end = None if span.end is None else start + round(span.end * 1e9)
        for entry in merged:
            if end is not None and entry[1] > end:
                return
            if entry[1] >= begin:
                yield self._message(*entry)

    def _message(self, topic: str, time: int, data: bytes) -> Message:
        if self.metadata.compression == "message":
            data = zstandard.ZstdDecompressor().decompressobj().decompress(data)
        return Message(self._names[topic], time, data)

    def attachments(self) -> dict[str, bytes]:
        """Files that were stored with the messages, by name."""
        result: dict[str, bytes] = {}
        for storage in self._storages:
            result |= storage.attachments()
        return result


def _look(path: Path, problems: list[str]) -> tuple[Metadata, list[Path]]:
    """Metadata and data files of what lies at a path."""
    if path.name == FILE:
        path = path.parent
    if path.is_file():
        storage = "sqlite3" if ".db3" in path.suffixes else "mcap"
        return Metadata(storage, [path.name], distro=""), [path]
    if not path.is_dir():
        raise BagError(f"there is no recording at {path}", hint="give its folder or its data file")
    present = sorted(
        file
        for file in path.iterdir()
        if set(file.suffixes) & set(_STORAGES)
        and file.is_file()
        and not file.name.endswith((".reserve", "-wal", "-shm"))
    )
    try:
        metadata = read_metadata(path)
    except BagError as error:
        if not present:
            raise BagError(
                f"{path} is not a recording", got="neither metadata.yaml nor .mcap or .db3 files"
            ) from error
        problems.append(f"{error}; read from its data files alone")
        storage = "sqlite3" if ".db3" in present[0].suffixes else "mcap"
        return Metadata(storage, [file.name for file in present], distro=""), present
    files = []
    for name in metadata.files:
        file = path / Path(name).name
        packed = file.with_name(file.name + ".zstd")
        if not file.is_file() and packed.is_file():
            file = packed
        if file.is_file():
            files.append(file)
        else:
            problems.append(f"{file.name} is missing from {path}")
    if not files:
        raise BagError(f"{path} has no data file", got=", ".join(metadata.files) or "none named")
    return metadata, files
