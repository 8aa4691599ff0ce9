"""The tables of interfaces.md, parameters.md and the README say what the nodes really declare."""

import importlib.util
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

TOOL = Path(__file__).resolve().parent.parent / "tools" / "interface_tables.py"


def test_the_documented_interfaces_are_the_real_ones():
    spec = importlib.util.spec_from_file_location("interface_tables", TOOL)
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    for path, wanted in tool.documents().items():
        assert path.read_text() == wanted, f"{path.name} is out of date: run `make docs`"
