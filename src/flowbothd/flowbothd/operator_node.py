"""Stands in for the person at the robot: waits for the graph, starts the policy, keeps the record.

It is the one process of `flowbothd demo` that sees the simulation's ground truth, and it uses it
only to judge and to draw.
"""

from __future__ import annotations

import argparse
import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from flowbothd.report.collector import Collector
from flowbothd_bringup.sim_graph import sim_nodes
from flowbothd_common.errors import FlowBotError
from flowbothd_common.parent_watch import watch_parent
from flowbothd_common.ros.liveness import PeerWatch
from flowbothd_common.types import Outcome
from flowbothd_evaluation.record_files import write_json
from flowbothd_evaluation.run_record.record import RunRecord, save_record
from flowbothd_policy.commands import Decision
from franka_suction_driver.arm.params import ARM_JOINTS

READY_TIMEOUT = 90.0
"""Seconds for all nodes to be ready; starting six Python processes on two cores takes ten."""


class OperatorError(FlowBotError):
    """The graph did not do what was asked in time."""


class Operator:
    """Drives one run of a graph that is already started.

    Args:
        node: Node of its own; spun here, never from a callback.
        record: Is filled; its predictor says which nodes the graph has.
    """

    def __init__(self, node: Node, record: RunRecord) -> None:
        self._node, self.record = node, record
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._peers = PeerWatch(node, sim_nodes(record.predictor))
        self.collector = Collector(node, record, ARM_JOINTS)
        self._start = node.create_client(Trigger, "policy/start")
        self._stop = node.create_client(Trigger, "policy/stop")

    def wait(self, done: Callable[[], bool], timeout: float, what: Callable[[], str]) -> None:
        """Spin until `done`.

        Raises:
            OperatorError: not done within `timeout` seconds; the message is `what()`.
        """
        deadline = time.monotonic() + timeout
        while not done():
            if time.monotonic() > deadline:
                raise OperatorError(what(), hint=f"waited {timeout:.0f} s")
            self._executor.spin_once(timeout_sec=0.1)

    def call(self, client: Any, request: Any, timeout: float) -> Any:
        """Call a service and return its answer.

        Raises:
            OperatorError: no server, or no answer in time.
        """
        self.wait(client.service_is_ready, timeout, lambda: f"service {client.srv_name} is missing")
        future = client.call_async(request)
        self.wait(future.done, timeout, lambda: f"service {client.srv_name} does not answer")
        return future.result()

    def run(self, timeout: float) -> None:
        """Wait for the graph, start the policy, and wait for its outcome.

        Raises:
            OperatorError: nodes that do not get ready, a refused start, or no outcome in time.
        """
        log = self._node.get_logger()

        def missing() -> str:
            return "nodes are not ready: " + "; ".join(
                f"{name}: {why}" for name, why in self._peers.missing().items()
            )

        self.wait(lambda: not self._peers.missing(), READY_TIMEOUT, missing)
        self.wait(lambda: bool(self.record.states), 10.0, lambda: "no sim/state")
        self.record.mode = self.collector.mode
        log.info(f"all nodes are ready: {self.record.object} {self.record.mode}")
        answer = self.call(self._start, Trigger.Request(), 10.0)
        if not answer.success:
            raise OperatorError("the policy did not start", got=answer.message)
        began = time.monotonic()
        try:
            self.wait(
                lambda: bool(self.record.outcome),
                timeout,
                lambda: f"no outcome after {len(self.record.decisions)} decisions",
            )
        except OperatorError:
            self.call(self._stop, Trigger.Request(), 5.0)
            raise
        finally:
            self.record.wall_s = time.monotonic() - began
        # The joint's last positions may still be under way when the outcome arrives.
        for _ in range(5):
            self._executor.spin_once(timeout_sec=0.1)


def _abort(reason: str) -> Decision:
    """The operator's own decision, last in the record of a run that the graph did not end."""
    return Decision(
        -1, 0.0, "", "", "abort", reason, step=0, grasps=0, trials=0, outcome=Outcome.ERROR.value
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--object", required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--predictor", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--timeout", type=float, required=True)
    return parser.parse_args()


def main() -> int:
    """Run one demo as a process; 0 opened, 1 not opened, 2 the graph failed."""
    logging.basicConfig(level=logging.INFO, format="[%(levelname)s] [%(name)s]: %(message)s")
    arguments = _arguments()
    watch_parent()
    record = RunRecord(arguments.object, "", arguments.seed, arguments.predictor)
    rclpy.init()
    node = Node("operator")
    code = 2
    try:
        try:
            Operator(node, record).run(arguments.timeout)
            code = 0 if record.summary().success else 1
        except OperatorError as error:
            node.get_logger().error(str(error))
            record.decisions.append(_abort(str(error)))
        write_json(arguments.out / "summary.json", record.summary())
        save_record(record, arguments.out)
    except (KeyboardInterrupt, ExternalShutdownException):
        code = 130
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return code


if __name__ == "__main__":
    raise SystemExit(main())
