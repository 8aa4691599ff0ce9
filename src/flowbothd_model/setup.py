"""Build description of flowbothd_model for colcon and pip."""

from setuptools import find_packages, setup

NAME = "flowbothd_model"

setup(
    name=NAME,
    version="0.1.0",
    description="The FlowBotHD network: data, training, sampling.",
    packages=find_packages(include=[NAME, NAME + ".*"]),
    package_data={NAME: ["**/*.yaml", "**/*.json", "**/*.xml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
)
