"""Build description of flowbothd_evaluation for colcon and pip."""

from setuptools import find_packages, setup

NAME = "flowbothd_evaluation"

setup(
    name=NAME,
    version="0.1.0",
    description="Stepped rollouts, the experiments with arm and paper, openings and benchmarks.",
    packages=find_packages(include=[NAME, NAME + ".*"]),
    package_data={NAME: ["**/*.yaml", "**/*.json", "**/*.xml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
)
