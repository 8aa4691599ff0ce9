"""Build description of franka_suction_driver for colcon and pip."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "franka_suction_driver"
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
        "ros-sensor-msgs~=5.3",
        "ros-std-msgs~=5.3",
        "ros-std-srvs~=5.3",
        "ros-trajectory-msgs~=5.3",
        "coal",
        "example-robot-data",
        "numpy>=1.26",
        "pin",
        "ruckig",
        "scipy",
    ],
    extras_require={
        "test": [
            "ros-rcl-interfaces>=2.0,<3",
            "ros-rosgraph-msgs>=2.0,<3",
            "sim_bridge",
            "pybullet",
            "pytest",
        ],
        "panda": ["panda-python"],
    },
    entry_points={
        "console_scripts": [
            "motion_node = franka_suction_driver.motion_node:main",
            "arm_node = franka_suction_driver.arm_node:main",
            "pump_node = franka_suction_driver.pump_node:main",
            "suction_node = franka_suction_driver.suction.suction_node:main",
        ]
    },
)
