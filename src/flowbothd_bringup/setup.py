"""Build description of flowbothd_bringup for colcon and pip."""

from setuptools import find_packages, setup

NAME = "flowbothd_bringup"

setup(
    name=NAME,
    version="0.1.0",
    description="The flowbothd command line, launch files, parameters, demo and evaluation.",
    packages=find_packages(include=[NAME, NAME + ".*"]),
    package_data={NAME: ["**/*.yaml", "**/*.json", "**/*.xml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
        (
            "share/" + NAME + "/launch",
            ["launch/sim.launch.py", "launch/real.launch.py", "launch/replay.launch.py"],
        ),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"], "rerun": ["rerun-sdk>=0.26"]},
    entry_points={
        "console_scripts": [
            "flowbothd = flowbothd_bringup.cli:main",
            "recorder_node = flowbothd_bringup.bags.recorder_node:main",
            "player_node = flowbothd_bringup.replay.player_node:main",
        ]
    },
)
