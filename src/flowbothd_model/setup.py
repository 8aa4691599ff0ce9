"""Build description of flowbothd_model for colcon and pip."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "flowbothd_model"
PACKAGE = ElementTree.parse(Path(__file__).resolve().parent / "package.xml")
VERSION = PACKAGE.findtext("version")
# models is a link to the repository's folder of weights.
WEIGHTS = sorted(path for path in Path("models").glob("*") if path.is_dir())

setup(
    name=NAME,
    version=VERSION,
    description=PACKAGE.findtext("description"),
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=find_packages(include=[NAME, NAME + ".*"]),
    package_data={NAME: ["**/*.yaml", "**/*.json", "**/*.xml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
        *((f"share/{NAME}/{folder}", sorted(map(str, folder.glob("*")))) for folder in WEIGHTS),
    ],
    install_requires=[
        "flowbothd_common==" + VERSION,
        "matplotlib",
        "numpy>=1.26",
        "pyyaml",
        "safetensors",
        "torch",
        "tqdm",
    ],
    extras_require={"test": ["pytest"]},
)
