"""ROS parameter files: read into one level of dotted names, and written for `--params-file`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

Parameters = dict[str, dict[str, Any]]
"""Node name -> parameter name -> value."""


def read_parameters(path: Path) -> Parameters:
    """Parameters of a ROS YAML file: node -> name -> value, groups flattened to dotted names."""
    content = yaml.safe_load(path.read_text()) or {}
    return {node: flat_parameters(entry["ros__parameters"]) for node, entry in content.items()}


def flat_parameters(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested groups of parameters as one level of dotted names."""
    result: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            result.update(flat_parameters(value, f"{prefix}{name}."))
        else:
            result[prefix + name] = value
    return result


class _PlainDumper(yaml.SafeDumper):  # type: ignore[misc]
    """ROS refuses YAML in which one list stands for two parameters."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write equal lists twice."""
        return True


def write_parameters(path: Path, parameters: Parameters) -> None:
    """Write parameters as the ROS YAML file that `--params-file` takes."""
    content = {node: {"ros__parameters": values} for node, values in parameters.items()}
    path.write_text(yaml.dump(content, Dumper=_PlainDumper, sort_keys=True))
