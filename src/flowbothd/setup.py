"""Build description of flowbothd for colcon and pip."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "flowbothd"
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
        "flowbothd_bringup==" + VERSION,
        "flowbothd_common==" + VERSION,
        "flowbothd_evaluation==" + VERSION,
        "flowbothd_interfaces==" + VERSION,
        "flowbothd_model==" + VERSION,
        "flowbothd_perception==" + VERSION,
        "flowbothd_policy==" + VERSION,
        "flowbothd_rosbag==" + VERSION,
        "franka_suction_driver==" + VERSION,
        "sim_bridge==" + VERSION,
        "ros-builtin-interfaces>=2.0,<3",
        "ros-geometry-msgs~=5.3",
        "ros-rclpy[fastrtps]~=7.1.6",
        "ros-sensor-msgs~=5.3",
        "ros-std-srvs~=5.3",
        "matplotlib",
        "numpy>=1.26",
        "pin",
        "pyyaml",
        "torch",
    ],
    extras_require={
        "test": ["pytest", "ros-std-msgs~=5.3"],
        "panda": ["franka_suction_driver[panda]"],
        "view": ["rerun-sdk>=0.26"],
    },
    entry_points={
        "console_scripts": [
            "flowbothd = flowbothd.cli:main",
        ]
    },
)
