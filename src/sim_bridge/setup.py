"""Build description of sim_bridge for colcon and pip."""

from setuptools import find_packages, setup

NAME = "sim_bridge"

setup(
    name=NAME,
    version="0.1.0",
    description="PyBullet world, depth camera, suction-cup physics and their ROS bridge.",
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
            "bridge_node = sim_bridge.bridge_node:main",
            "oracle_node = sim_bridge.oracle_node:main",
        ]
    },
)
