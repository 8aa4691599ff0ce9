"""The dependency rules of ARCHITECTURE.md, read from the import statements of every module."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / "src"

PACKAGES = {path.parent.name for path in SOURCES.glob("*/setup.py")}
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
}
LAUNCH = {"launch", "launch_ros"}
HEAVY = {
    "torch",
    "pybullet",
    "open3d",
    "pinocchio",
    "coal",
    "ruckig",
    "panda_py",
    "honcho",
    "mcap",
    "rerun",
}

# What a package's cores may import of the modules above, besides themselves and flowbothd_common.
ALLOWED = {
    "flowbothd_common": set(),
    "flowbothd_model": {"torch", "open3d"},
    "flowbothd_perception": {"open3d", "pinocchio", "coal"},
    "flowbothd_policy": set(),
    "franka_suction_driver": {"pinocchio", "coal", "ruckig"},
    "sim_bridge": {"pybullet", "open3d"},
    "flowbothd_rosbag": {"mcap"},
    "flowbothd_bringup": {
        "honcho",
        "flowbothd_perception",
        "flowbothd_policy",
        "flowbothd_rosbag",
        "franka_suction_driver",
        "sim_bridge",
    },
    "flowbothd_evaluation": {
        "torch",
        "open3d",
        "pinocchio",
        "flowbothd_model",
        "flowbothd_perception",
        "flowbothd_policy",
        "flowbothd_rosbag",
        "franka_suction_driver",
        "sim_bridge",
    },
    "flowbothd": ROS | {"torch", "pinocchio", "rerun"} | PACKAGES,
}
# One line each: a module that may import more than its package's cores.
EXCEPTIONS = {
    "flowbothd_bringup/launching.py": LAUNCH,
    "flowbothd_policy/inference_node.py": {"flowbothd_model"},
}
# Besides `*_node.py`, `*_ros.py` and flowbothd_common/ros: modules that speak ROS.
ROS_MODULES = {
    "flowbothd_evaluation/benchmarks/bench_record.py",
    "flowbothd_evaluation/benchmarks/perception_load.py",
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
    speaks_ros = (
        name.endswith(("_node.py", "_ros.py"))
        or name.startswith("flowbothd_common/ros/")
        or name in ROS_MODULES
        or package == "flowbothd"
    )
    allowed = ALLOWED[package] | EXCEPTIONS.get(name, set()) | {package, "flowbothd_common"}
    if speaks_ros:
        allowed |= ROS
    ruled = ROS | LAUNCH | HEAVY | PACKAGES
    wrong = [full for top, full in imports if top in ruled and top not in allowed]
    if not speaks_ros:
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
    upward = ("flowbothd_bringup", "flowbothd_bringup.sim_graph")
    assert violations("flowbothd_evaluation", "flowbothd_evaluation/trials.py", {upward})
    assert violations("flowbothd_bringup", "flowbothd_bringup/sim_graph.py", {("launch", "launch")})


def package_imports() -> dict[str, set[str]]:
    """Package -> other packages of this project that any of its modules imports."""
    found: dict[str, set[str]] = {package: set() for package in PACKAGES}
    for path in modules():
        package = path.relative_to(SOURCES).parts[0]
        found[package] |= {top for top, _ in imported(path)} & PACKAGES - {package}
    return found


def levels(imports: dict[str, set[str]]) -> list[set[str]]:
    """Packages in the order in which they can be built; ends early where a circle begins."""
    order: list[set[str]] = []
    done: set[str] = set()
    while ready := {p for p, needed in imports.items() if p not in done and needed <= done}:
        order.append(ready)
        done |= ready
    return order


def test_packages_have_no_circle():
    """The incident this guards against: a package that can be built only after itself."""
    order = levels(package_imports())
    assert set().union(*order) == PACKAGES
    assert order[0] == {"flowbothd_common"}
    assert order[-1] == {"flowbothd"}
    assert levels({"a": {"b"}, "b": {"a"}, "c": set()}) == [{"c"}]


def test_nobody_imports_the_command_line():
    assert [p for p, needed in package_imports().items() if "flowbothd" in needed] == []
    tests = [p for p in SOURCES.glob("*/test/*.py") if p.parts[-3] != "flowbothd"]
    assert [p.name for p in tests if "flowbothd" in {top for top, _ in imported(p)}] == []


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_package_xml_names_the_packages_that_are_imported(package):
    """The incident: colcon builds in the order of package.xml, and a missing name breaks it."""
    text = (SOURCES / package / "package.xml").read_text()
    named = set(re.findall(r"<exec_depend>(\w+)</exec_depend>", text)) & PACKAGES
    assert package_imports()[package] <= named


def test_types_are_checked_across_all_packages():
    """The incident this guards against: types of a package that mypy cannot find are all Any."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]
    assert set(settings["mypy_path"]) == {f"src/{package}" for package in PACKAGES}


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(SOURCES)))
def test_a_module_is_small_enough_to_be_read(path):
    lines = len(path.read_text().splitlines())
    limit = 200 if path.name.endswith("_node.py") else 400
    assert lines <= limit, f"{path.name} has {lines} lines, allowed {limit}: split it"
