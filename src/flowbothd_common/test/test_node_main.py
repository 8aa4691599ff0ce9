"""A node that is told to stop while it works leaves nothing alive."""

import subprocess
import sys

import pytest

STOPPED_WHILE_PUBLISHING = """
import os, signal, sys, weakref
import rclpy
from rclpy.node import Node
from std_msgs.msg import Header
from flowbothd_common.ros.node_main import run_node


class Held:
    def __del__(self):
        os.write(1, b"freed ")


class Publishing(Node):
    def __init__(self):
        super().__init__("publishing")
        self.publisher = self.create_publisher(Header, "x", 1)
        self.timer = self.create_timer(0.01, self.on_timer)

    def on_timer(self):
        held = Held()
        os.kill(os.getpid(), signal.SIGTERM)
        while rclpy.ok():
            pass
        self.publisher.publish(Header())
        del held


code = run_node(Publishing)
os.write(1, b"returned ")
raise SystemExit(code)
"""


@pytest.mark.ros
def test_what_an_interrupted_callback_held_is_freed_before_the_process_ends():
    """Open3D ends a process with an error if anything of its own is alive at the end."""
    done = subprocess.run(
        [sys.executable, "-c", STOPPED_WHILE_PUBLISHING],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["freed", "returned"]
