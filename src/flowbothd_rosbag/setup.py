"""Build description of flowbothd_rosbag for colcon and pip."""

from setuptools import find_packages, setup

NAME = "flowbothd_rosbag"

setup(
    name=NAME,
    version="0.1.0",
    description="rosbag2 recordings: reading, writing, recording from a graph, playing back.",
    packages=find_packages(include=[NAME, NAME + ".*"]),
    package_data={NAME: ["**/*.yaml", "**/*.json", "**/*.xml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "recorder_node = flowbothd_rosbag.recorder_node:main",
            "player_node = flowbothd_rosbag.player_node:main",
        ]
    },
)
