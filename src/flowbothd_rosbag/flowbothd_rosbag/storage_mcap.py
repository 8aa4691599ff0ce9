"""mcap data files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Schema
from mcap.records import Message as McapMessage
from mcap.summary import Summary

from flowbothd_rosbag.mcap_repair import DAMAGED, is_complete, pieces
from flowbothd_rosbag.metadata import Topic, parse_qos


class McapStorage:
    """One mcap file; without its end it is read record by record as far as that goes.

    Args:
        path: The file.

    Raises:
        BagError: this is no mcap file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.topics: dict[str, Topic] = {}
        self.problems: list[str] = []
        self._counts: dict[str, int] | None = None
        self._summary = self._read_summary()
        if self._summary is None:
            self._scan()
        else:
            self._use(self._summary)

    def _read_summary(self) -> Summary | None:
        if not is_complete(self._path):
            self.problems.append(
                f"{self._path.name} was not closed (cut off, or its writer was killed); read up to "
                "the last whole record; `flowbothd record --recover` completes it"
            )
            return None
        try:
            with self._path.open("rb") as file:
                summary = SeekingReader(file).get_summary()
        except DAMAGED as error:
            self.problems.append(f"{self._path.name} has a damaged index ({error}); read without")
            return None
        if summary is None or (not summary.channels and not summary.statistics):
            return None
        return summary

    def _use(self, summary: Summary) -> None:
        for channel in summary.channels.values():
            self._add(channel, summary.schemas.get(channel.schema_id))
        if summary.statistics is not None:
            counts: Counter[str] = Counter()
            for number, count in summary.statistics.channel_message_counts.items():
                counts[summary.channels[number].topic] += count
            self._counts = dict(counts)

    def _scan(self) -> None:
        """Learn the topics from the records themselves."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        counts: Counter[str] = Counter()
        for piece in pieces(self._path):
            for record in (piece.record, *piece.inner):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                    self._add(record, schemas.get(record.schema_id))
                elif isinstance(record, McapMessage) and record.channel_id in channels:
                    counts[channels[record.channel_id].topic] += 1
        self._counts = dict(counts)

    def _add(self, channel: Channel, schema: Schema | None) -> None:
        kind = "" if schema is None else schema.name
        # Writers other than rosbag2 leave out the middle word.
        kind = kind if kind.count("/") != 1 else kind.replace("/", "/msg/")
        self.topics[channel.topic] = Topic(
            channel.topic,
            kind,
            parse_qos(channel.metadata.get("offered_qos_profiles", "")),
            channel.metadata.get("topic_type_hash", ""),
            channel.message_encoding,
        )

    @property
    def indexed(self) -> bool:
        """Whether it has an index, as a file has that was closed."""
        return self._summary is not None

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic."""
        if self._counts is None:
            self._counts = dict(Counter(t for t, _, _ in self.messages(frozenset(self.topics))))
        return self._counts

    def messages(self, topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, receive time and content of every message, in time order where there is an index.

        Damage on the way ends the stream and is noted in `problems`.
        """
        if self._summary is None:
            yield from self._unindexed(topics)
            return
        try:
            with self._path.open("rb") as file:
                reader = SeekingReader(file)
                for _, channel, message in reader.iter_messages(topics=list(topics)):
                    yield channel.topic, message.log_time, message.data
        except DAMAGED as error:
            self.problems.append(f"{self._path.name} is damaged ({error}); read up to there")

    def _unindexed(self, topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
        channels: dict[int, Channel] = {}
        for piece in pieces(self._path):
            batch = []
            for record in (piece.record, *piece.inner):
                if isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, McapMessage) and record.channel_id in channels:
                    topic = channels[record.channel_id].topic
                    if topic in topics:
                        batch.append((topic, record.log_time, record.data))
            yield from sorted(batch, key=lambda entry: entry[1])

    def attachments(self) -> dict[str, bytes]:
        """Files within, by name."""
        if self._summary is None:
            found = (piece.record for piece in pieces(self._path))
            return {a.name: a.data for a in found if isinstance(a, Attachment)}
        with self._path.open("rb") as file:
            return {a.name: a.data for a in SeekingReader(file).iter_attachments()}
