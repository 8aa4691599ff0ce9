"""Build description of franka_suction_driver for colcon and pip."""

from setuptools import find_packages, setup

NAME = "franka_suction_driver"

setup(
    name=NAME,
    version="0.1.0",
    description="Motion and suction for a Franka arm with a suction cup.",
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
            "motion_node = franka_suction_driver.motion_node:main",
            "arm_node = franka_suction_driver.arm_node:main",
            "pump_node = franka_suction_driver.pump_node:main",
            "suction_node = franka_suction_driver.suction.suction_node:main",
        ]
    },
)
