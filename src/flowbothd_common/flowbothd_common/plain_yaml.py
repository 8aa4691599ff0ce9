"""YAML as ROS reads it: without aliases."""

from __future__ import annotations

from typing import Any

import yaml

# rosbag2's metadata is written every second; the dumper in Python alone takes 20 ms each time.
_Fast: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class _PlainDumper(_Fast):  # type: ignore[misc]
    """ROS refuses YAML in which one list stands for two parameters, and rosbag2 all aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write equal lists twice."""
        return True


def plain_yaml(content: Any, *, sort_keys: bool = False) -> str:
    """Return plain values, lists and mappings as YAML without aliases.

    Args:
        content: Made of what YAML knows by itself; numpy values are refused.
        sort_keys: Sort mappings by key; otherwise they keep their order.

    Raises:
        yaml.representer.RepresenterError: A value is of another type.
    """
    text: str = yaml.dump(content, Dumper=_PlainDumper, sort_keys=sort_keys)
    return text
