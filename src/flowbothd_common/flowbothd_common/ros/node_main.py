"""Runs one node as a process: arguments, signals, clear errors, and no orphan."""

from __future__ import annotations

import ctypes
import logging
import os
import signal
import sys
from collections.abc import Callable

import rclpy
from rclpy.executors import (
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.node import Node

from flowbothd_common.errors import FlowBotError
from flowbothd_common.ros.parameters import reject_unknown

DIE_WITH_PARENT = "FLOWBOTHD_DIE_WITH_PARENT"
"""Set in the environment by a process manager whose nodes must not outlive it."""

_PR_SET_PDEATHSIG = 1


def _die_with_parent() -> None:
    """Ask Linux for a SIGTERM when the parent process dies, however it dies."""
    if os.environ.get(DIE_WITH_PARENT) and sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() == 1:
            raise SystemExit("the process that started this node is gone")


def run_node(create: Callable[[], Node], args: list[str] | None = None, *, threads: int = 1) -> int:
    """Create a node, spin it until it is told to stop, and clean up.

    Args:
        create: Makes the node; raises FlowBotError on bad parameters.
        args: Command line, sys.argv if omitted; ROS arguments are understood.
        threads: Executor threads; more than one only where a callback must block.

    Returns:
        0 after a requested shutdown, 2 if the node could not be created.
    """
    logging.basicConfig(level=logging.INFO, format="[%(levelname)s] [%(name)s]: %(message)s")
    _die_with_parent()
    rclpy.init(args=args)
    node: Node | None = None
    executor = None
    try:
        node = create()
        reject_unknown(node)
        executor = (
            MultiThreadedExecutor(num_threads=threads) if threads > 1 else SingleThreadedExecutor()
        )
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except FlowBotError as error:
        # The message is written for people; a traceback would hide it.
        sys.stderr.write(f"[ERROR] {error}\n")
        return 2
    finally:
        if executor is not None:
            executor.shutdown(timeout_sec=1.0)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
