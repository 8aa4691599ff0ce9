"""Build description of flowbothd_rosbag for colcon and pip."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "flowbothd_rosbag"
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
        "ros-rcl-interfaces>=2.0,<3",
        "ros-rclpy[fastrtps]~=7.1.6",
        "ros-rosgraph-msgs>=2.0,<3",
        "ros-std-msgs~=5.3",
        "mcap",
        "pyyaml",
        "zstandard",
    ],
    extras_require={"test": ["numpy>=1.26", "pytest", "ros-sensor-msgs~=5.3", "rosbags"]},
    entry_points={
        "console_scripts": [
            "recorder_node = flowbothd_rosbag.recorder_node:main",
            "player_node = flowbothd_rosbag.player_node:main",
        ]
    },
)
