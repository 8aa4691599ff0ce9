"""Build description of flowbothd_policy for colcon and pip."""

from setuptools import find_packages, setup

NAME = "flowbothd_policy"

setup(
    name=NAME,
    version="0.1.0",
    description="The articulation manipulation policy, its node and the inference node.",
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
            "policy_node = flowbothd_policy.policy_node:main",
            "inference_node = flowbothd_policy.inference_node:main",
        ]
    },
)
