"""Build description of flowbothd_bringup for colcon and pip."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "flowbothd_bringup"
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
        ("share/" + NAME + "/config", sorted(map(str, Path("config").glob("*.yaml")))),
        ("share/" + NAME + "/launch", sorted(map(str, Path("launch").glob("*.launch.py")))),
    ],
    install_requires=[
        "flowbothd_common==" + VERSION,
        "flowbothd_interfaces==" + VERSION,
        "flowbothd_perception==" + VERSION,
        "flowbothd_policy==" + VERSION,
        "flowbothd_rosbag==" + VERSION,
        "franka_suction_driver==" + VERSION,
        "sim_bridge==" + VERSION,
        "ros-rclpy[fastrtps]~=7.1.6",
        "honcho",
        "pyyaml",
    ],
    extras_require={"test": ["numpy>=1.26", "psutil", "pytest", "ros-rcl-interfaces>=2.0,<3"]},
)
