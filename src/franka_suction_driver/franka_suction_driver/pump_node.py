"""pump_node: the pump by topics, in a process of its own, since reading it blocks Python."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

from rclpy.node import Node

from flowbothd_common.errors import SuctionError
from flowbothd_common.ros import qos
from flowbothd_common.ros.diagnostics import ERROR, OK, NodeStatus
from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from flowbothd_interfaces.msg import SuctionCommand, SuctionMeasurement
from franka_suction_driver.backend_params import PumpNodeParams
from franka_suction_driver.backends.cobot_pump import CobotPump
from franka_suction_driver.backends.connection import Connection
from franka_suction_driver.backends.mock import MockLibrary
from franka_suction_driver.backends.protocol import PumpBackend

_RETRY = 5.0
"""Pause between two attempts to connect [s]: one may block for seconds."""


class PumpNode(Node):
    """Topics `suction/command` in, `suction/measurement` out."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("pump_node", **kwargs)
        params = declare(self, PumpNodeParams)
        self._pump: PumpBackend = _backend(params)
        self._refused = ""
        self._connection = Connection(self._pump.connect, _RETRY, "the pump")
        self._measurement = self.create_publisher(
            SuctionMeasurement, "suction/measurement", qos.STATE
        )
        self._guard = guard = Guard(self, self._on_failure)
        guard.subscribe(SuctionCommand, "suction/command", self._on_command, qos.COMMAND)
        self._status = NodeStatus(self, guard)
        guard.every(1.0 / params.poll_rate, self._on_timer)

    def destroy_node(self) -> None:
        """Release and switch off, whatever ends the node."""
        self._connection.close()
        self._pump.close()
        self._status.close()
        super().destroy_node()

    def _on_failure(self, why: str) -> None:
        """Report the failure as a fault of the pump, which keeps its last set-point."""
        self._refused = why

    def _on_command(self, message: SuctionCommand) -> None:
        if not self._connection.made:
            return
        try:
            self._pump.command(message.vacuum)
            self._refused = ""
        except SuctionError as error:
            # Told as a fault, since nobody waits for an answer to a topic.
            self._refused = str(error)

    def _on_timer(self) -> None:
        if not self._connection.poll():
            self._status.report(ERROR, self._connection.trouble)
            return
        reading = self._pump.reading()
        if reading is None:
            self._status.report(ERROR, "no state of the pump yet")
            return
        fault = self._refused or reading.fault
        message = SuctionMeasurement(
            vacuum=float(reading.vacuum),
            in_control_range=reading.in_control_range,
            part_present=reading.part_present,
            part_detached=reading.part_detached,
            fault=bool(fault),
            fault_message=fault,
        )
        message.header.stamp = self.get_clock().now().to_msg()
        self._measurement.publish(message)
        self._status.report(ERROR if fault else OK, fault or "pump connected")


def _backend(params: PumpNodeParams) -> PumpBackend:
    if params.backend == "mock":
        address = params.robot_ip or "mock"
        return CobotPump(replace(params, robot_ip=address), library=MockLibrary())
    return CobotPump(params)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(PumpNode, args)


if __name__ == "__main__":
    sys.exit(main())
