"""Message classes by the names that recordings use."""

from __future__ import annotations

import importlib
from typing import Any

from flowbothd_rosbag.metadata import BagError

_FEEDBACK = "_FeedbackMessage"


def type_of(cls: Any) -> str:
    """Name of a message class, such as ``sensor_msgs/msg/Image``."""
    package, group = cls.__module__.split(".")[:2]
    return f"{package}/{group}/{cls.__name__}"


def message_class(kind: str) -> Any:
    """Class of a type such as ``sensor_msgs/msg/Image``.

    Raises:
        BagError: the type is not installed.
    """
    words = kind.split("/")
    if len(words) == 2:
        words.insert(1, "msg")
    try:
        package, group, name = words
        module = importlib.import_module(f"{package}.{group}")
        if group == "action" and name.endswith(_FEEDBACK):
            return getattr(module, name.removesuffix(_FEEDBACK)).Impl.FeedbackMessage
        return getattr(module, name)
    except (ImportError, AttributeError, ValueError) as error:
        raise BagError(
            f"message type {kind} is not installed",
            hint=f"install or build the package {words[0]} to record or play it",
        ) from error
