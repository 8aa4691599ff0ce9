"""Definitions of message types, as recordings carry them for readers that do not have them."""

from __future__ import annotations

import os
import re
from pathlib import Path

_BUILT_IN = re.compile(r"(bool|byte|char|w?string|float(32|64)|u?int(8|16|32|64))$")
_FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?\s*(?:\[[^\]]*\])?\s+\w+")
_LINE = "\n" + 80 * "=" + "\nMSG: "
_FEEDBACK, _FEEDBACK_PART = "_FeedbackMessage", "_Feedback"


def definition(kind: str) -> str:
    """Text of a type such as ``std_msgs/msg/Header`` with all that it is made of (ros2msg).

    Empty if the type or a part of it is not installed, and for what services send: readers such as
    `rosbags` refuse a whole recording for a definition whose name has `srv` in it.
    """
    try:
        first = _text(kind)
        parts = {kind: first}
        queue = _needs(kind, first)
        while queue:
            name = queue.pop(0)
            if name not in parts:
                parts[name] = _text(name)
                queue += _needs(name, parts[name])
    except FileNotFoundError:
        return ""
    return first + "".join(
        f"{_LINE}{_short(name)}\n{text}" for name, text in parts.items() if name != kind
    )


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


def _needs(kind: str, text: str) -> list[str]:
    package = kind.split("/", maxsplit=1)[0]
    result = []
    for line in text.splitlines():
        found = _FIELD.match(line.split("#", maxsplit=1)[0])
        if found is None or _BUILT_IN.match(found[1]):
            continue
        words = found[1].split("/")
        if len(words) == 1:
            result.append(f"{package}/msg/{words[0]}")
        else:
            result.append(f"{words[0]}/{words[1] if len(words) > 2 else 'msg'}/{words[-1]}")
    return result


def _text(kind: str) -> str:
    package, group, name = kind.split("/")
    if group == "msg":
        return _file(package, f"msg/{name}.msg")
    if group == "action" and name.endswith(_FEEDBACK):
        action = f"{package}/action/{name.removesuffix(_FEEDBACK)}"
        return f"unique_identifier_msgs/UUID goal_id\n{action}{_FEEDBACK_PART} feedback\n"
    if group == "action" and name.endswith(_FEEDBACK_PART):
        text = _file(package, f"action/{name.removesuffix(_FEEDBACK_PART)}.action")
        return re.split(r"^---\s*$", text, flags=re.MULTILINE)[2]
    raise FileNotFoundError(kind)


def _file(package: str, name: str) -> str:
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix) / "share" / package / name
        if prefix and path.is_file():
            return path.read_text()
    raise FileNotFoundError(f"{package}/{name}")
