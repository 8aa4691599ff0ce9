"""Completes mcap files whose writer was killed: cut back to the last whole record, indexed anew."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.stream_reader import breakup_chunk

from flowbothd_rosbag.mcap_index import MAGIC, McapIndex
from flowbothd_rosbag.metadata import BagError

_HEAD = struct.Struct("<BQ")
_KINDS: dict[int, type[McapRecord]] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}
DAMAGED = (McapError, ValueError, struct.error, UnicodeDecodeError, zstandard.ZstdError)
"""What the mcap library raises on records that are cut off or overwritten."""


@dataclass(frozen=True)
class Piece:
    """One record of the data section.

    Attributes:
        offset: Where it begins in the file.
        length: Of the whole record.
        record: As read.
        inner: Records within, for chunks.
    """

    offset: int
    length: int
    record: McapRecord
    inner: tuple[McapRecord, ...] = ()


def is_complete(path: Path) -> bool:
    """Whether the file ends as an mcap file must."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        if size < 2 * len(MAGIC):
            return False
        file.seek(size - len(MAGIC))
        return file.read() == MAGIC


def pieces(path: Path) -> Iterator[Piece]:
    """Whole, undamaged records of the data section in order, up to its end or the first damage.

    Raises:
        BagError: this is no mcap file.
    """
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise BagError(f"{path} is not an mcap file", hint="is it empty or another format?")
        offset = len(MAGIC)
        while head := _whole(file, _HEAD.size):
            opcode, length = _HEAD.unpack(head)
            content = _whole(file, length)
            if content is None or opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            try:
                piece = _piece(opcode, content, offset)
            except DAMAGED:
                return
            if piece is not None:
                yield piece
            offset += _HEAD.size + length


def _whole(file: BinaryIO, length: int) -> bytes | None:
    # Asked first: a damaged length may ask for more memory than there is.
    here = file.tell()
    if file.seek(0, 2) - here < length:
        return None
    file.seek(here)
    return file.read(length)


def _piece(opcode: int, content: bytes, offset: int) -> Piece | None:
    length = _HEAD.size + len(content)
    stream = ReadDataStream(BytesIO(content))
    if opcode == Opcode.MESSAGE:
        return Piece(offset, length, Message.read(stream, len(content)))
    if opcode not in _KINDS:
        return None
    record = _KINDS[opcode].read(stream)  # type: ignore[attr-defined]
    inner = tuple(breakup_chunk(record, validate_crc=True)) if isinstance(record, Chunk) else ()
    return Piece(offset, length, record, inner)


def repair(path: Path) -> McapIndex:
    """Cut the file back to its last whole record and give it an index and an end.

    Raises:
        BagError: this is no mcap file.
        OSError: the file cannot be written.
    """
    index, end = McapIndex(), len(MAGIC)
    for piece in pieces(path):
        if isinstance(piece.record, Message):
            raise BagError(
                f"{path} has messages outside of chunks, which no index can name",
                hint="it is read as it is; `mcap recover` of the mcap tools completes it",
            )
        _collect(index, piece)
        end = piece.offset + piece.length
    if end == len(MAGIC):
        # Not even a header was read by name; it is kept if it is there.
        end = _header_end(path)
    with path.open("r+b") as file:
        file.truncate(end)
        file.seek(end)
        file.write(index.ending(end))
    return index


def _header_end(path: Path) -> int:
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        head = _whole(file, _HEAD.size)
        if head is None:
            raise BagError(f"{path} ends before its first record", hint="nothing can be saved")
        return len(MAGIC) + _HEAD.size + int(_HEAD.unpack(head)[1])


def _collect(index: McapIndex, piece: Piece) -> None:
    record, offset, length = piece.record, piece.offset, piece.length
    for entry in (record, *piece.inner):
        if isinstance(entry, Schema):
            index.schemas[entry.id] = entry
        elif isinstance(entry, Channel):
            index.channels[entry.id] = entry
    if isinstance(record, Chunk):
        counts = Counter(entry.channel_id for entry in piece.inner if isinstance(entry, Message))
        chunk = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression=record.compression,
            compressed_size=len(record.data),
            message_end_time=record.message_end_time,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=record.message_start_time,
            uncompressed_size=record.uncompressed_size,
        )
        index.add_chunk(chunk, dict(counts))
    elif isinstance(record, MessageIndex) and index.chunks:
        index.chunks[-1].message_index_offsets[record.channel_id] = offset
        index.chunks[-1].message_index_length += length
    elif isinstance(record, Attachment):
        times = (record.log_time, record.create_time, len(record.data))
        index.attachments.append(
            AttachmentIndex(offset, length, *times, record.name, record.media_type)
        )
    elif isinstance(record, Metadata):
        index.metadata.append(MetadataIndex(offset, length, record.name))
