"""What a recording says about the run beside its messages: parameters, calibration, weights."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from flowbothd_common.plain_yaml import plain_yaml
from flowbothd_common.versions import versions

PARAMETERS = "parameters.yaml"
CALIBRATION = "calibration.yaml"
WEIGHTS = "weights.yaml"
DESCRIPTION = "robot_description.urdf"
VERSIONS = "versions.yaml"

Parameters = Mapping[str, Mapping[str, Any]]


def parameters_text(parameters: Parameters) -> str:
    """The parameters as the ROS YAML file that `--params-file` takes."""
    content = {node: {"ros__parameters": dict(v)} for node, v in sorted(parameters.items())}
    return plain_yaml(content, sort_keys=True)


def calibration_text(parameters: Parameters) -> str:
    """Where the camera stands, by the node that uses it; empty if none says so."""
    values = {
        node: {name: v for name, v in given.items() if name.startswith("camera.")}
        for node, given in parameters.items()
        if "camera.position" in given and node.endswith("perception_node")
    }
    return plain_yaml(values, sort_keys=True) if values else ""


def versions_text() -> str:
    """Versions of what matters, on the machine that records."""
    return plain_yaml(versions())
