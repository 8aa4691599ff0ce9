"""Build description of flowbothd_perception for colcon and pip."""

from setuptools import find_packages, setup

NAME = "flowbothd_perception"

setup(
    name=NAME,
    version="0.1.0",
    description="From camera to object cloud: crop, robot-body filter, outlier removal, sampling.",
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
            "perception_node = flowbothd_perception.perception_node:main",
        ]
    },
)
