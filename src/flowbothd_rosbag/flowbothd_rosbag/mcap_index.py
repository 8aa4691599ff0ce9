"""What an mcap file says at its end about itself: every channel, chunk and attachment."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"


def encoded(*records: McapRecord) -> bytes:
    """The records as they stand in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


@dataclass
class McapIndex:
    """Collected while a file is written or looked through.

    Attributes:
        schemas: By id.
        channels: By id.
        chunks: In the order of the file.
        attachments: In the order of the file.
        metadata: In the order of the file.
        counts: Messages by channel.
        start: Earliest log time [ns]; 0 without messages.
        end: Latest log time [ns].
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    start: int = 0
    end: int = 0

    def add_chunk(self, chunk: ChunkIndex, counts: dict[int, int]) -> None:
        """Take in a chunk and how many messages each channel has in it."""
        first = not self.counts
        self.chunks.append(chunk)
        for channel, count in counts.items():
            self.counts[channel] = self.counts.get(channel, 0) + count
        begin = chunk.message_start_time
        self.start = begin if first else min(self.start, begin)
        self.end = max(self.end, chunk.message_end_time)

    def ending(self, offset: int) -> bytes:
        """Everything from the end of the data to the end of the file.

        Args:
            offset: Where in the file it will stand.
        """
        data_end = encoded(DataEnd(0))
        summary_start = offset + len(data_end)
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*self.schemas.values()]),
            (Opcode.CHANNEL, [*self.channels.values()]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self.chunks]),
            (Opcode.ATTACHMENT_INDEX, [*self.attachments]),
            (Opcode.METADATA_INDEX, [*self.metadata]),
        ]
        summary, offsets = b"", []
        for opcode, records in groups:
            group = encoded(*records)
            if group:
                offsets.append(SummaryOffset(opcode, summary_start + len(summary), len(group)))
            summary += group
        offset_start = summary_start + len(summary)
        summary += encoded(*offsets)
        # The checksum covers the footer up to itself.
        places = struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offset_start)
        footer = Footer(summary_start, offset_start, zlib.crc32(summary + places))
        return data_end + summary + encoded(footer) + MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self.chunks),
            message_count=sum(self.counts.values()),
            message_end_time=self.end,
            message_start_time=self.start,
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )
