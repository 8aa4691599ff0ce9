"""Writes mcap files that are readable up to the last chunk whatever happens to the writer."""

from __future__ import annotations

import struct
from pathlib import Path

import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
)

from flowbothd_rosbag.mcap_index import MAGIC, McapIndex, encoded

_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<BQQQQII4sQ")

RESERVE = 2 * 1024 * 1024
"""Bytes kept free for the index at the end, so that a full disk leaves a complete file."""

SMALL, FAST = 1, -5
"""Levels of zstd: good compression, and three times the speed when the disk cannot wait."""


class McapWriter:
    """One mcap file under construction; not safe to be used from two threads at once.

    Every chunk goes to the operating system as a whole as soon as it is full or `flush` is called,
    so that a process that is killed loses what came since. When a write fails, the file is cut back
    to the last whole chunk before the error is raised, and `close` then completes it.

    Args:
        path: New file.
        chunk_size: Bytes of messages after which a chunk is written.

    Raises:
        OSError: the file cannot be made.
    """

    def __init__(self, path: Path, chunk_size: int = 4 * 1024 * 1024) -> None:
        self.path, self._chunk_size = path, chunk_size
        self.index = McapIndex()
        self.level = SMALL
        self._reserve = path.with_name(path.name + ".reserve")
        self._reserve.write_bytes(bytes(RESERVE))
        self._file = path.open("xb", buffering=0)
        self._offset = 0
        self._buffers: list[bytes] = []
        self._size = 0
        self._messages: dict[int, list[tuple[int, int]]] = {}
        self._append(MAGIC + encoded(Header("ros2", "flowbothd")))

    @property
    def offset(self) -> int:
        """Bytes written so far."""
        return self._offset

    def add_channel(
        self, topic: str, kind: str, definition: str, about: dict[str, str], encoding: str = "cdr"
    ) -> int:
        """Announce a topic.

        Args:
            topic: Its name.
            kind: Type of its messages.
            definition: Of the type and all that it is made of, as ros2msg; empty if unknown.
            about: Metadata of the channel.
            encoding: Of its messages.

        Returns:
            Number for `write`.
        """
        schemas = self.index.schemas
        known = [schema.id for schema in schemas.values() if schema.name == kind]
        records: list[McapRecord] = []
        if not known:
            format_name = "ros2msg" if definition else ""
            schema = Schema(len(schemas) + 1, definition.encode(), format_name, kind)
            records.append(schema)
            known = [schema.id]
        number = len(self.index.channels) + 1
        channel = Channel(number, topic, encoding, about, known[0])
        self._append(encoded(*records, channel))
        for record in records:
            schemas[known[0]] = record  # type: ignore[assignment]
        self.index.channels[number] = channel
        return number

    def write(self, channel: int, log: int, publish: int, data: bytes, sequence: int = 0) -> None:
        """Add a message; times in nanoseconds."""
        self._messages.setdefault(channel, []).append((log, self._size))
        head = _MESSAGE.pack(
            Opcode.MESSAGE, _MESSAGE.size - 9 + len(data), channel, sequence, log, publish
        )
        self._buffers += (head, data)
        self._size += len(head) + len(data)
        if self._size >= self._chunk_size:
            self.flush()

    def flush(self) -> None:
        """Write what has been collected as a chunk.

        Raises:
            OSError: the file is as it was before this chunk, whose messages are gone.
        """
        if not self._messages:
            return
        plain, messages, size = b"".join(self._buffers), self._messages, self._size
        self._buffers, self._messages, self._size = [], {}, 0
        # The checksum lies within the zstd frame: faster, and every reader checks it.
        packed = zstandard.ZstdCompressor(level=self.level, write_checksum=True).compress(plain)
        times = [log for entries in messages.values() for log, _ in entries]
        begin, end = min(times), max(times)
        head = _CHUNK.pack(
            Opcode.CHUNK,
            _CHUNK.size - 9 + len(packed),
            begin,
            end,
            size,
            0,
            4,
            b"zstd",
            len(packed),
        )
        chunk_length = len(head) + len(packed)
        offset, indices, places = self._offset, [], {}
        place = offset + chunk_length
        for channel, entries in messages.items():
            places[channel] = place
            indices.append(encoded(MessageIndex(channel, entries)))
            place += len(indices[-1])
        self._append(b"".join([head, packed, *indices]))
        chunk = ChunkIndex(
            chunk_length=chunk_length,
            chunk_start_offset=offset,
            compression="zstd",
            compressed_size=len(packed),
            message_end_time=end,
            message_index_length=place - offset - chunk_length,
            message_index_offsets=places,
            message_start_time=begin,
            uncompressed_size=size,
        )
        self.index.add_chunk(chunk, {channel: len(e) for channel, e in messages.items()})

    def attach(self, name: str, media_type: str, data: bytes, time: int) -> None:
        """Add a file of its own, such as the parameters of the nodes."""
        offset = self._offset
        record = encoded(Attachment(time, time, name, media_type, data))
        self._append(record)
        self.index.attachments.append(
            AttachmentIndex(offset, len(record), time, time, len(data), name, media_type)
        )

    def note(self, name: str, values: dict[str, str]) -> None:
        """Add named values."""
        offset = self._offset
        record = encoded(Metadata(name, values))
        self._append(record)
        self.index.metadata.append(MetadataIndex(offset, len(record), name))

    def close(self) -> None:
        """Write what is left, and the index.

        Raises:
            OSError: not even the index could be written; `repair` completes the file later.
        """
        self._reserve.unlink(missing_ok=True)
        try:
            self.flush()
        finally:
            try:
                self._append(self.index.ending(self._offset))
            finally:
                self._file.close()

    def _append(self, data: bytes) -> None:
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) or 0 :]
        except OSError:
            self._file.truncate(self._offset)
            self._file.seek(self._offset)
            raise
        self._offset += len(data)
