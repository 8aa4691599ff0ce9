"""Versions of what decides how a run goes."""

from __future__ import annotations

import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

PACKAGES = (
    "flowbothd",
    "ros-rclpy",
    "ros-rmw-fastrtps-cpp",
    "numpy",
    "scipy",
    "torch",
    "pin",
    "coal",
    "ruckig",
    "pybullet",
    "open3d-cpu",
    "open3d",
    "mcap",
    "rerun-sdk",
    "panda-python",
)


def versions() -> dict[str, str]:
    """Name -> version of every package that matters and is installed, Python and machine."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    found |= {"Python": sys.version.split()[0], "machine": platform.platform()}
    if "ros-rclpy" not in found:
        found["ros"] = _apt_ros()
    return found


def _apt_ros() -> str:
    found = find_spec("rclpy")
    return "not installed" if found is None else f"rclpy of {found.origin}"
