"""Build description of sim_bridge for colcon and pip."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "sim_bridge"
PACKAGE = ElementTree.parse(Path(__file__).resolve().parent / "package.xml")
VERSION = PACKAGE.findtext("version")

setup(
    name=NAME,
    version=VERSION,
    description=PACKAGE.findtext("description"),
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=find_packages(include=[NAME, NAME + ".*"]),
    package_data={NAME: ["**/*.yaml", "**/*.json", "**/*.xml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
    ],
    install_requires=[
        "flowbothd_common==" + VERSION,
        "flowbothd_interfaces==" + VERSION,
        "ros-geometry-msgs~=5.3",
        "ros-rclpy[fastrtps]~=7.1.6",
        "ros-rosgraph-msgs>=2.0,<3",
        "ros-sensor-msgs~=5.3",
        "ros-std-msgs~=5.3",
        "ros-trajectory-msgs~=5.3",
        "numpy>=1.26",
        'open3d-cpu; platform_machine == "x86_64"',
        'open3d; platform_machine != "x86_64"',
        "pybullet",
        "pyyaml",
        "scipy",
        "trimesh",
    ],
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "bridge_node = sim_bridge.bridge_node:main",
            "oracle_node = sim_bridge.oracle_node:main",
        ]
    },
)
