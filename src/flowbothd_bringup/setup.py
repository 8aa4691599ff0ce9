"""Build description of flowbothd_bringup for colcon and pip."""

from setuptools import find_packages, setup

NAME = "flowbothd_bringup"

setup(
    name=NAME,
    version="0.1.0",
    description="Launch files, parameters and the description of each node graph.",
    packages=find_packages(include=[NAME, NAME + ".*"]),
    package_data={NAME: ["**/*.yaml", "**/*.json", "**/*.xml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
        ("share/" + NAME + "/config", ["config/sim.yaml", "config/robot.yaml", "config/fr3.yaml"]),
        (
            "share/" + NAME + "/launch",
            ["launch/sim.launch.py", "launch/robot.launch.py", "launch/replay.launch.py"],
        ),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
)
