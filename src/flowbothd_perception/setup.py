"""Build description of flowbothd_perception for colcon and pip."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "flowbothd_perception"
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
        "ros-builtin-interfaces>=2.0,<3",
        "ros-rclpy[fastrtps]~=7.1.6",
        "ros-sensor-msgs~=5.3",
        "ros-std-msgs~=5.3",
        "coal",
        "numpy>=1.26",
        "opencv-python-headless",
        "pin",
        "scipy",
    ],
    extras_require={"test": ["hypothesis", "pytest", "pyyaml", "ros-diagnostic-msgs~=5.3"]},
    entry_points={
        "console_scripts": [
            "perception_node = flowbothd_perception.perception_node:main",
        ]
    },
)
