"""The dependency rules of ARCHITECTURE.md, read from the import statements of every module."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / "src"

PACKAGES = {
    "flowbothd_common",
    "flowbothd_model",
    "flowbothd_perception",
    "flowbothd_policy",
    "franka_suction_driver",
    "sim_bridge",
    "flowbothd_bringup",
}
ROS = {
    "rclpy",
    "flowbothd_interfaces",
    "action_msgs",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "lifecycle_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "trajectory_msgs",
    "launch",
    "launch_ros",
}
HEAVY = {"torch", "pybullet", "open3d", "pinocchio", "coal", "ruckig", "panda_py", "honcho"}

# What a package's cores may import of the modules above, beside flowbothd_common.
ALLOWED = {
    "flowbothd_common": set(),
    "flowbothd_model": {"torch", "open3d"},
    "flowbothd_perception": {"open3d", "pinocchio", "coal"},
    "flowbothd_policy": set(),
    "franka_suction_driver": {"pinocchio", "coal", "ruckig"},
    "sim_bridge": {"pybullet", "open3d"},
    "flowbothd_bringup": ROS | HEAVY | PACKAGES,
}
# One line each: a module that may import more than its package's cores.
EXCEPTIONS = {
    "flowbothd_policy/inference_node.py": {"flowbothd_model"},
}


def modules() -> list[Path]:
    return sorted(
        path
        for package in PACKAGES
        for path in (SOURCES / package / package).rglob("*.py")
        if "__pycache__" not in path.parts
    )


def imported(path: Path) -> set[tuple[str, str]]:
    """(top-level module, full module) of every import in a file."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {(alias.name.split(".")[0], alias.name) for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add((node.module.split(".")[0], node.module))
    return found


def violations(package: str, name: str, imports: set[tuple[str, str]]) -> list[str]:
    """Imports of the module `name` (package/file) that the rules forbid."""
    is_ros_glue = name.startswith("flowbothd_common/ros/")
    is_node = name.endswith(("_node.py", "_ros.py"))
    allowed = ALLOWED[package] | EXCEPTIONS.get(name, set()) | {package, "flowbothd_common"}
    if is_node or is_ros_glue:
        allowed |= ROS
    wrong = [
        full for top, full in imports if top in (ROS | HEAVY | PACKAGES) and top not in allowed
    ]
    if not (is_node or is_ros_glue or package == "flowbothd_bringup"):
        wrong += [full for _, full in imports if full.startswith("flowbothd_common.ros")]
        wrong += [full for _, full in imports if full.endswith(("_node", "_ros"))]
    return sorted(wrong)


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(SOURCES)))
def test_a_module_imports_only_what_its_layer_may(path):
    package = path.relative_to(SOURCES).parts[0]
    name = str(path.relative_to(SOURCES / package))
    assert violations(package, name, imported(path)) == []


def test_the_rules_would_notice_a_violation():
    """The incident: a core that imports rclpy works everywhere but where ROS is missing."""
    assert violations("flowbothd_policy", "flowbothd_policy/grasp.py", {("rclpy", "rclpy")})
    assert violations("flowbothd_policy", "flowbothd_policy/grasp.py", {("torch", "torch")})
    assert not violations(
        "flowbothd_policy", "flowbothd_policy/policy_node.py", {("rclpy", "rclpy")}
    )
    assert violations(
        "sim_bridge", "sim_bridge/world.py", {("franka_suction_driver", "franka_suction_driver.ik")}
    )


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(SOURCES)))
def test_a_module_is_small_enough_to_be_read(path):
    lines = len(path.read_text().splitlines())
    limit = 200 if path.name.endswith("_node.py") else 400
    assert lines <= limit, f"{path.name} has {lines} lines, allowed {limit}: split it"
