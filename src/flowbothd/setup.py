"""Build description of flowbothd for colcon and pip."""

from setuptools import find_packages, setup

NAME = "flowbothd"

setup(
    name=NAME,
    version="0.1.0",
    description="The flowbothd command line.",
    packages=find_packages(include=[NAME, NAME + ".*"]),
    package_data={NAME: ["**/*.yaml", "**/*.json", "**/*.xml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"], "rerun": ["rerun-sdk>=0.26"]},
    entry_points={
        "console_scripts": [
            "flowbothd = flowbothd.cli:main",
        ]
    },
)
