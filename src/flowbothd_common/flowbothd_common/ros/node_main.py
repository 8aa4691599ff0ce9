"""Runs one node as a process: arguments, signals, clear errors, and no orphan."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable

import rclpy
from rclpy.executors import (
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from flowbothd_common.errors import FlowBotError
from flowbothd_common.malloc_tuning import free_what_stayed, keep_freed_memory, spare_what_stays
from flowbothd_common.parent_watch import watch_parent
from flowbothd_common.ros.parameters import check_files, reject_unknown

RCLError = rclpy_implementation.RCLError


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0]


def run_node(
    create: Callable[[], Node],
    args: list[str] | None = None,
    *,
    threads: int = 1,
    strict_files: bool = False,
) -> int:
    """Create a node, spin it until it is stopped, and clean up.

    Args:
        create: Makes the node; raises FlowBotError on bad parameters.
        args: Command line, sys.argv if omitted; ROS arguments are understood.
        threads: Executor threads; more than one only where a callback must block.
        strict_files: Refuse a parameter file that has no entry for the node; otherwise warn. For
            nodes that move an arm: they must not run with other limits than the user wrote.

    Returns:
        0 after a requested shutdown, 2 if the node could not be created.
    """
    logging.basicConfig(level=logging.INFO, format="[%(levelname)s] [%(name)s]: %(message)s")
    watch_parent()
    keep_freed_memory()
    try:
        rclpy.init(args=args)
    except RCLError as error:
        sys.stderr.write(f"[ERROR] ROS does not accept the arguments: {_first_line(error)}\n")
        return 2
    node: Node | None = None
    executor = None
    try:
        node = create()
        reject_unknown(node)
        check_files(node, sys.argv if args is None else args, strict=strict_files)
        executor = (
            MultiThreadedExecutor(num_threads=threads) if threads > 1 else SingleThreadedExecutor()
        )
        executor.add_node(node)
        spare_what_stays()
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        # A callback was publishing while SIGTERM took the context away.
        if rclpy.ok():
            raise
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
        executor = node = None
        free_what_stayed()
    return 0
