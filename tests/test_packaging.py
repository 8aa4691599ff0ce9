"""Every package names what it imports, in setup.py and package.xml, and all have one version."""

from __future__ import annotations

import ast
import contextlib
import re
import runpy
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest
import setuptools
import yaml

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / "src"
PACKAGES = sorted(path.parent.name for path in SOURCES.glob("*/setup.py"))
MANIFESTS = sorted(SOURCES.glob("*/package.xml"))


class Source(NamedTuple):
    """Where a module comes from: name on the package index, and rosdep key."""

    distribution: str
    key: str


# rosdep has python3-NAME for what Debian packages and python3-NAME-pip for the rest.
THIRD_PARTY = {
    "PIL": Source("pillow", "python3-pil"),
    "coal": Source("coal", "python3-coal-pip"),
    "cv2": Source("opencv-python-headless", "python3-opencv"),
    "honcho": Source("honcho", "python3-honcho-pip"),
    "hypothesis": Source("hypothesis", "python3-hypothesis"),
    "matplotlib": Source("matplotlib", "python3-matplotlib"),
    "mcap": Source("mcap", "python3-mcap-pip"),
    "numpy": Source("numpy", "python3-numpy"),
    "open3d": Source("open3d", "python3-open3d-pip"),
    "pinocchio": Source("pin", "python3-pin-pip"),
    "psutil": Source("psutil", "python3-psutil"),
    "pybullet": Source("pybullet", "python3-pybullet-pip"),
    "pytest": Source("pytest", "python3-pytest"),
    "rerun": Source("rerun-sdk", "python3-rerun-sdk-pip"),
    "rosbags": Source("rosbags", "python3-rosbags-pip"),
    "ruckig": Source("ruckig", "python3-ruckig-pip"),
    "safetensors": Source("safetensors", "python3-safetensors-pip"),
    "scipy": Source("scipy", "python3-scipy"),
    "torch": Source("torch", "python3-torch-pip"),
    "tqdm": Source("tqdm", "python3-tqdm"),
    "trimesh": Source("trimesh", "python3-trimesh-pip"),
    "yaml": Source("pyyaml", "python3-yaml"),
    "zstandard": Source("zstandard", "python3-zstandard"),
}
ONLY_WITH_ROS = {"launch", "launch_ros"}
"""Packages of ROS that have no wheel: package.xml names them, setup.py cannot."""


def source_of(module: str) -> Source:
    """Modules of ROS are called like their packages; on the index their names begin with ros-."""
    if module in THIRD_PARTY:
        return THIRD_PARTY[module]
    ours = module in {path.parent.name for path in MANIFESTS}
    return Source(normalised(module if ours else f"ros-{module}"), module)


def normalised(name: str) -> str:
    return name.lower().replace("_", "-")


def imports_of(files: list[Path]) -> set[str]:
    """Modules outside the standard library that the files import, wherever in them."""
    found: set[str] = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                found.add(node.module)
    return {name.split(".")[0] for name in found} - sys.stdlib_module_names


def production_imports(package: str) -> set[str]:
    folder = SOURCES / package
    files = [*(folder / package).rglob("*.py"), *folder.glob("launch/*.py")]
    return imports_of(files) - {package}


def test_imports(package: str) -> set[str]:
    own = {path.stem for path in (SOURCES / package / "test").rglob("*.py")}
    return imports_of(list((SOURCES / package / "test").rglob("*.py"))) - own - {package}


test_imports.__test__ = False


class Declared(NamedTuple):
    """What a setup.py requires, always and by extra, and the files that it installs to share."""

    always: frozenset[str]
    extras: dict[str, frozenset[str]]
    shared: frozenset[str]


@cache
def declared(package: str) -> Declared:
    """What setup.py hands to setuptools."""
    given: dict[str, Any] = {}
    real, setuptools.setup = setuptools.setup, lambda **arguments: given.update(arguments)
    try:
        with contextlib.chdir(SOURCES / package):
            runpy.run_path("setup.py")
    finally:
        setuptools.setup = real
    always = given["install_requires"]
    for requirement in always:
        if name_of(requirement) in map(normalised, PACKAGES):
            assert requirement.endswith(f"=={given['version']}"), "packages are released together"
    extras = {extra: names_of(found) for extra, found in given["extras_require"].items()}
    shared = frozenset(file for _, files in given["data_files"] for file in files)
    return Declared(names_of(always), extras, shared)


def name_of(requirement: str) -> str:
    name = normalised(re.match(r"[\w.-]+", requirement).group())
    # The same library without its windows, and without a build for other processors.
    return "open3d" if name == "open3d-cpu" else name


def names_of(requirements: list[str]) -> frozenset[str]:
    return frozenset(map(name_of, requirements))


def keys(package: str, *tags: str) -> set[str]:
    root = ElementTree.parse(SOURCES / package / "package.xml").getroot()
    return {element.text for tag in tags for element in root.iter(tag)}


@pytest.mark.parametrize("package", PACKAGES)
def test_setup_py_requires_what_is_imported(package):
    """The incident: wheels required nothing, and every import of an installed package failed."""
    wanted = {source_of(m).distribution for m in production_imports(package) - ONLY_WITH_ROS}
    found = declared(package)
    optional = frozenset().union(*(v for k, v in found.extras.items() if k != "test"))
    assert wanted <= found.always | optional
    tested = {source_of(m).distribution for m in test_imports(package)}
    assert tested <= found.always | found.extras["test"]


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_depends_on_what_is_imported(package):
    """The incident: rosdep installed eight of thirty libraries, and colcon's order was luck."""
    assert {source_of(m).key for m in production_imports(package)} <= keys(package, "exec_depend")
    tested = {source_of(m).key for m in test_imports(package)}
    assert tested <= keys(package, "exec_depend", "test_depend")


def test_only_view_and_hardware_are_optional():
    """An extra that hides a library which a command needs would break that command."""
    extras = {p: set(declared(p).extras) - {"test"} for p in PACKAGES}
    assert {p: e for p, e in extras.items() if e} == {
        "flowbothd": {"panda", "view"},
        "franka_suction_driver": {"panda"},
    }


def test_own_rosdep_keys_are_those_that_are_missing_elsewhere():
    own = yaml.safe_load((ROOT / "rosdep.yaml").read_text())
    used = set().union(*(keys(p, "exec_depend", "test_depend") for p in PACKAGES))
    # Looked up in the python.yaml of rosdep's public database.
    pip = {"python3-open3d-pip", "python3-pybullet-pip", "python3-trimesh-pip"}
    apt = (
        "hypothesis",
        "matplotlib",
        "numpy",
        "opencv",
        "pil",
        "psutil",
        "pytest",
        "scipy",
        "tqdm",
    )
    public = pip | {f"python3-{name}" for name in (*apt, "yaml")}
    assert {key for key in used if key.startswith("python3-")} - public == set(own)


def test_all_packages_have_the_version_of_the_version_file():
    version = (ROOT / "VERSION").read_text().strip()
    assert re.fullmatch(r"\d+\.\d+\.\d+", version)
    found = {m.parent.name: ElementTree.parse(m).findtext("version") for m in MANIFESTS}
    assert found == dict.fromkeys(found, version), "write it with tools/set_version.py"


@pytest.mark.parametrize("manifest", MANIFESTS, ids=lambda path: path.parent.name)
def test_no_package_states_its_version_a_second_time(manifest):
    project = tomllib.loads((manifest.parent / "pyproject.toml").read_text())["project"]
    assert "version" in project["dynamic"] and "version" not in project
    build = manifest.parent / "setup.py"
    if build.is_file():
        assert not re.search(r"\d+\.\d+\.\d+", build.read_text().replace("~=7.1.6", ""))


def test_a_new_version_reaches_every_package(tmp_path):
    for manifest in MANIFESTS:
        copy = tmp_path / manifest.relative_to(ROOT)
        copy.parent.mkdir(parents=True)
        copy.write_text(manifest.read_text())
    script = [sys.executable, str(ROOT / "tools" / "set_version.py")]
    subprocess.run([*script, "1.20.3", str(tmp_path)], timeout=60, check=True)
    copies = list(tmp_path.glob("src/*/package.xml"))
    assert len(copies) == len(MANIFESTS)
    assert {ElementTree.parse(copy).findtext("version") for copy in copies} == {"1.20.3"}
    assert (tmp_path / "VERSION").read_text() == "1.20.3\n"
    refused = subprocess.run([*script, "1.2", str(tmp_path)], timeout=60, check=False)
    assert refused.returncode == 2


def test_the_installed_interfaces_name_the_packages_that_they_use():
    text = (SOURCES / "flowbothd_interfaces" / "pyproject.toml").read_text()
    required = names_of(tomllib.loads(text)["project"]["dependencies"])
    named = keys("flowbothd_interfaces", "depend", "exec_depend")
    assert {source_of(key).distribution for key in named} == required


def test_weights_configuration_and_launch_files_are_shared():
    """The incident: an installed package found no weights, since only a checkout had them."""
    found = {package: declared(package).shared for package in PACKAGES}
    weights = {str(path.relative_to(ROOT)) for path in (ROOT / "models").glob("*/*")}
    assert weights and weights <= found["flowbothd_model"]
    folder = SOURCES / "flowbothd_bringup"
    files = {str(path.relative_to(folder)) for path in folder.glob("[cl]*/*.[yp]*")}
    assert {"config/sim.yaml", "launch/sim.launch.py"} <= files <= found["flowbothd_bringup"]
    assert all("package.xml" in shared for shared in found.values())


def test_the_weights_are_stored_once():
    link = SOURCES / "flowbothd_model" / "models"
    assert link.is_symlink() and link.resolve() == ROOT / "models"
