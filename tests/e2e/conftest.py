"""A running graph for tests: started, listened to, and gone afterwards."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

FLOWBOTHD = (sys.executable, "-m", "flowbothd.cli")

START_TIMEOUT = 120.0
"""Ten times what six processes take to start on two idle cores."""

_domains = itertools.count(1 + os.getpid() % 40)


class Graph:
    """`flowbothd up sim` in a process of its own, and an ear on its domain."""

    def __init__(self, log: Path, *arguments: str) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from sensor_msgs.msg import JointState

        from flowbothd_common.ros import qos
        from flowbothd_interfaces.msg import Heartbeat, MotionResult, PolicyDecision, SimState

        self.domain = next(_domains)
        self.log = log
        self.predictor = "model"
        if "--predictor" in arguments:
            self.predictor = arguments[arguments.index("--predictor") + 1]
        self._file = log.open("w")
        self.process = subprocess.Popen(
            [*FLOWBOTHD, "up", "sim", *arguments, "--domain", str(self.domain)],
            stdout=self._file,
            stderr=subprocess.STDOUT,
        )
        self._context = Context()
        rclpy.init(context=self._context, domain_id=self.domain)
        self.node = Node("test_ear", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.diagnostics: list[tuple[float, str, int, str]] = []
        self.ready: dict[str, bool] = {}
        self.joints: list[tuple[float, list[float]]] = []
        self.decisions: list[object] = []
        self.results: list[object] = []
        self.sim: object | None = None
        for kind, name, callback, profile in (
            (DiagnosticArray, "/diagnostics", self._on_diagnostics, 10),
            (Heartbeat, "heartbeat", self._on_heartbeat, qos.HEARTBEAT),
            (JointState, "joint_states", self._on_joints, qos.STATE),
            (PolicyDecision, "policy/decisions", self.decisions.append, qos.EVENT),
            (MotionResult, "motion/result", self.results.append, qos.EVENT),
            (SimState, "sim/state", self._on_sim, qos.STATE),
        ):
            self.node.create_subscription(kind, name, callback, profile)

    def _on_diagnostics(self, message) -> None:
        for status in message.status:
            level = int.from_bytes(status.level, "little")
            self.diagnostics.append((time.monotonic(), status.name, level, status.message))

    def _on_heartbeat(self, message) -> None:
        self.ready[message.node] = message.ready

    def _on_joints(self, message) -> None:
        self.joints.append((time.monotonic(), list(message.velocity)))

    def _on_sim(self, message) -> None:
        self.sim = message

    def spin(self, seconds: float) -> None:
        """Listen for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.02)

    def wait(self, condition: Callable[[], object], timeout: float, what: str) -> None:
        """Listen until the condition holds."""
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, f"{what} did not come in {timeout} s\n{self.tail()}"
            assert self.process.poll() is None, f"the graph ended\n{self.tail()}"
            self._executor.spin_once(timeout_sec=0.02)

    def wait_ready(self) -> None:
        """Listen until every node says that it can work."""
        from flowbothd_bringup.sim_graph import sim_nodes

        nodes = set(sim_nodes(self.predictor))
        self.wait(
            lambda: nodes <= {name for name, ready in self.ready.items() if ready},
            START_TIMEOUT,
            "all nodes ready",
        )

    def node_process(self, name: str) -> psutil.Process:
        """Process of one node."""
        module = name.replace("_node", "")
        for child in psutil.Process(self.process.pid).children(recursive=True):
            command = " ".join(child.cmdline())
            if f".{module}_node" in command and "--ros-args" in command:
                return child
        raise AssertionError(f"no process of {name}\n{self.tail()}")

    def tail(self) -> str:
        """End of the graph's output."""
        self._file.flush()
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-60:])

    def close(self) -> list[psutil.Process]:
        """Interrupt as Ctrl-C does; returns processes that are still there after 15 s."""
        import rclpy

        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)
        children = []
        if self.process.poll() is None:
            children = psutil.Process(self.process.pid).children(recursive=True)
            self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            self.process.kill()
        _, alive = psutil.wait_procs(children, timeout=15)
        self._file.close()
        return alive


@pytest.fixture
def start_graph(tmp_path: Path) -> Iterator[Callable[..., Graph]]:
    """Factory of graphs; none outlives its test."""
    graphs: list[Graph] = []

    def start(*arguments: str) -> Graph:
        graph = Graph(tmp_path / f"graph{len(graphs)}.log", *arguments)
        graphs.append(graph)
        return graph

    yield start
    left = [
        process for graph in graphs if graph.process.poll() is None for process in graph.close()
    ]
    for process in left:
        process.kill()
    assert not left, f"processes outlived the test: {left}"
