"""Clouds read straight from their serialised bytes.

A cloud at full rate is 180 MB a second. Making a PointCloud2 of it in Python copies every frame
several times and takes longer than all of perception; here its points are viewed where they are.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TypeAlias

from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from flowbothd_common.errors import InvalidCloudError

_LITTLE_ENDIAN_CDR = b"\x00\x01"


@dataclass(frozen=True)
class RawCloud:
    """Contents of a PointCloud2, its data a view of the received bytes; names as in the message."""

    header: Header
    height: int
    width: int
    fields: tuple[PointField, ...]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: memoryview
    is_dense: bool


AnyCloud: TypeAlias = RawCloud | PointCloud2
"""A cloud message, read one way or the other."""


def read_cloud(raw: bytes | PointCloud2) -> AnyCloud:
    """The cloud of a serialised sensor_msgs/PointCloud2, without a copy where that can be.

    A message is returned as it is.

    Raises:
        InvalidCloudError: the bytes end before the message does.
    """
    if not isinstance(raw, bytes):
        return raw
    if raw[:2] != _LITTLE_ENDIAN_CDR:
        # A big-endian sender, or another representation: the slow way understands those too.
        message: PointCloud2 = deserialize_message(raw, PointCloud2)
        return message
    try:
        return _read(_Cdr(memoryview(raw)[4:]))
    except (struct.error, UnicodeDecodeError) as error:
        raise InvalidCloudError(f"cloud message is damaged: {error}") from error


def _read(cdr: _Cdr) -> RawCloud:
    stamp = Time(sec=cdr.number("i"), nanosec=cdr.number("I"))
    header = Header(stamp=stamp, frame_id=cdr.text())
    height, width = cdr.number("I"), cdr.number("I")
    fields = tuple(
        PointField(
            name=cdr.text(),
            offset=cdr.number("I"),
            datatype=cdr.number("B"),
            count=cdr.number("I"),
        )
        for _ in range(cdr.number("I"))
    )
    is_bigendian = bool(cdr.number("B"))
    point_step, row_step = cdr.number("I"), cdr.number("I")
    data = cdr.take(cdr.number("I"))
    return RawCloud(
        header,
        height,
        width,
        fields,
        is_bigendian,
        point_step,
        row_step,
        data,
        bool(cdr.number("B")),
    )


class _Cdr:
    """Reads little-endian CDR: every number is aligned to its own size."""

    def __init__(self, view: memoryview) -> None:
        self._view, self._at = view, 0

    def number(self, kind: str) -> int:
        """The next number, of a kind of the struct module."""
        size = struct.calcsize(kind)
        self._at += -self._at % size
        value: int = struct.unpack_from("<" + kind, self._view, self._at)[0]
        self._at += size
        return value

    def text(self) -> str:
        """The next string."""
        return bytes(self.take(self.number("I"))).rstrip(b"\0").decode()

    def take(self, size: int) -> memoryview:
        """The next bytes."""
        if self._at + size > len(self._view):
            raise struct.error(f"{size} bytes wanted, {len(self._view) - self._at} left")
        self._at += size
        return self._view[self._at - size : self._at]
