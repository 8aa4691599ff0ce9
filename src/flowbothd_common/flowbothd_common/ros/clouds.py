"""Between PointCloud2 messages and arrays: plain clouds, flow predictions, histories."""

from __future__ import annotations

import array
from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.types import Cloud, History

XYZ = ("x", "y", "z")
XYZ_FLOW = (*XYZ, "flow_x", "flow_y", "flow_z")


def to_cloud_message(
    header: Header, values: np.ndarray, names: Sequence[str], data: array.array | None = None
) -> PointCloud2:
    """PointCloud2 of float32 fields.

    Args:
        header: Copied into the message.
        values: (N, F) for an unorganised cloud, (H, W, F) for an organised one.
        names: F field names.
        data: Buffer to reuse between messages (array.array("B")); None makes a new one.
    """
    packed = np.ascontiguousarray(values, dtype=np.float32)
    if packed.ndim == 2:
        packed = packed[None]
    height, width, count = packed.shape
    if count != len(names):
        raise ValueError(f"{count} values a point, but {len(names)} field names")
    raw = packed.reshape(-1).view(np.uint8)
    if data is None or len(data) != raw.size:
        data = array.array("B", bytes(raw.size))
    if raw.size:
        np.frombuffer(data, dtype=np.uint8)[:] = raw
    fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate(names)
    ]
    return PointCloud2(
        header=header,
        height=height,
        width=width,
        fields=fields,
        is_bigendian=False,
        point_step=4 * count,
        row_step=4 * count * width,
        data=data,
        is_dense=bool(np.isfinite(packed).all()),
    )


def from_cloud_message(message: PointCloud2, names: Sequence[str]) -> np.ndarray:
    """(height, width, F) float32 values of the named fields, of any stride and offset.

    Raises:
        InvalidCloudError: a field is missing or not float32, big-endian data, or fewer bytes than
            the sizes promise.
    """
    offsets = {field.name: field.offset for field in message.fields}
    missing = [name for name in names if name not in offsets]
    if missing:
        raise InvalidCloudError(
            "cloud lacks fields", got=", ".join(offsets) or "none", allowed=", ".join(names)
        )
    wrong = [f.name for f in message.fields if f.name in names and f.datatype != PointField.FLOAT32]
    if wrong or message.is_bigendian:
        raise InvalidCloudError(
            "cloud layout is not supported",
            got=f"fields {wrong}, big-endian {message.is_bigendian}",
            allowed="little-endian float32 fields",
        )
    height, width, step = message.height, message.width, message.point_step
    row_step = message.row_step if height > 1 and message.row_step else step * width
    needed = row_step * (height - 1) + step * width if height and width else 0
    if len(message.data) < needed or (width and step < max(offsets[n] for n in names) + 4):
        raise InvalidCloudError(
            "cloud data is shorter than its sizes say",
            got=f"{len(message.data)} bytes, point step {step}",
            allowed=f"{needed} bytes",
        )
    result = np.empty((height, width, len(names)), dtype=np.float32)
    if needed:
        buffer = np.frombuffer(message.data, dtype=np.uint8)
        for i, name in enumerate(names):
            result[..., i] = np.ndarray(
                (height, width),
                np.dtype("<f4"),
                buffer=buffer,
                offset=offsets[name],
                strides=(row_step, step),
            )
    return result


def to_flow_message(header: Header, points: Cloud, flows: np.ndarray) -> PointCloud2:
    """PointCloud2 with height = samples and width = points of (N, 3) points, (S, N, 3) flows."""
    repeated = np.broadcast_to(points, flows.shape)
    return to_cloud_message(header, np.concatenate([repeated, flows], axis=-1), XYZ_FLOW)


def from_flow_message(message: PointCloud2) -> tuple[Cloud, np.ndarray]:
    """(N, 3) points and (S, N, 3) flows.

    Raises:
        InvalidCloudError: see `from_cloud_message`; or no rows.
    """
    values = from_cloud_message(message, XYZ_FLOW)
    if not values.shape[0]:
        raise InvalidCloudError("flow message has no samples", got=0, allowed="at least 1")
    return np.ascontiguousarray(values[0, :, :3]), np.ascontiguousarray(values[..., 3:])


def to_history_message(header: Header, history: History | None) -> PointCloud2:
    """PointCloud2 of a history; width 0 if there is none."""
    if history is None:
        return to_cloud_message(header, np.empty((0, 6), np.float32), XYZ_FLOW)
    return to_flow_message(header, history.points, history.flow[None])


def from_history_message(message: PointCloud2) -> History | None:
    """The history, or None for width 0 (also for a default-constructed message)."""
    if message.width == 0:
        return None
    points, flows = from_flow_message(message)
    return History(points, flows[0])
