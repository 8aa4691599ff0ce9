"""suction_node: passes set-points to the pump and tells what became of the part."""

from __future__ import annotations

import sys
import time
from typing import Any

from rclpy.node import Node

from flowbothd_common.errors import SuctionError
from flowbothd_common.ros import qos
from flowbothd_common.ros.diagnostics import ERROR, OK, NodeStatus
from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from flowbothd_common.types import SuctionPhase, SuctionReading
from flowbothd_common.values import bounded
from flowbothd_interfaces.msg import SuctionCommand, SuctionMeasurement, SuctionState
from flowbothd_interfaces.srv import SetSuction
from franka_suction_driver.suction.suction import SuctionMachine, SuctionStatus
from franka_suction_driver.suction_params import SuctionParams

_PERIOD = 0.05
"""Period of the published state [s]."""
_REPEAT = 0.5
"""Period at which the set-point is sent again [s]: a pump or bridge that has restarted learns
it."""
_VACUUM_RANGE = (-1.0e4, 1.2e5)
"""Vacuum below ambient that a gauge can show: a little below zero, a little above all air [Pa]."""
_CODES = {
    SuctionPhase.OFF: SuctionState.OFF,
    SuctionPhase.BUILDING: SuctionState.BUILDING,
    SuctionPhase.HOLDING: SuctionState.HOLDING,
    SuctionPhase.LOST: SuctionState.LOST,
    SuctionPhase.FAULT: SuctionState.FAULT,
}


class SuctionNode(Node):
    """Service `suction/set`, topic `suction/state`; talks to the pump by topics."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("suction_node", **kwargs)
        params = declare(self, SuctionParams)
        self._machine = SuctionMachine(params, time.monotonic())
        self._state = self.create_publisher(SuctionState, "suction/state", qos.STATE)
        self._command = self.create_publisher(SuctionCommand, "suction/command", qos.COMMAND)
        self._last_command = 0.0
        # After a failure the set-point is not repeated, and the pump's own timeout releases.
        self._guard = guard = Guard(self)
        topic = "suction/measurement"
        guard.subscribe(SuctionMeasurement, topic, self._on_measurement, qos.STATE)
        guard.serve(SetSuction, "suction/set", self._on_set)
        self._status = NodeStatus(self, guard)
        guard.every(_PERIOD, self._on_timer)

    def destroy_node(self) -> None:
        """Switch the pump off before going."""
        if self._machine.status(time.monotonic()).vacuum > 0 and self.context.ok():
            self._send(0.0)
        self._status.close()
        super().destroy_node()

    def _on_set(
        self, request: SetSuction.Request, response: SetSuction.Response
    ) -> SetSuction.Response:
        try:
            self._machine.command(request.vacuum, time.monotonic())
        except SuctionError as error:
            response.success, response.message = False, str(error)
            return response
        self._send(request.vacuum)
        self._publish(self._machine.status(time.monotonic()))
        response.success = True
        return response

    def _on_measurement(self, message: SuctionMeasurement) -> None:
        fault = message.fault_message or "unknown" if message.fault else ""
        vacuum = bounded("vacuum of the pump", message.vacuum, *_VACUUM_RANGE, "Pa")
        reading = SuctionReading(vacuum, message.part_present, message.part_detached, fault)
        before = self._machine.status(time.monotonic()).phase
        self._machine.measure(reading, time.monotonic())
        status = self._machine.status(time.monotonic())
        if status.phase is not before:
            self._publish(status)

    def _on_timer(self) -> None:
        now = time.monotonic()
        status = self._machine.status(now)
        self._publish(status)
        # A pump or bridge that has restarted learns the set-point again.
        if now - self._last_command > _REPEAT:
            self._send(status.vacuum)
        level = ERROR if status.phase is SuctionPhase.FAULT else OK
        message = status.message or "pump ready"
        if level == ERROR and self._guard.troubles():
            message = "; ".join([message, *self._guard.troubles()])
        self._status.report(level, message, {"phase": status.phase.value})

    def _send(self, vacuum: float) -> None:
        self._last_command = time.monotonic()
        message = SuctionCommand(vacuum=float(vacuum))
        message.header.stamp = self.get_clock().now().to_msg()
        self._command.publish(message)

    def _publish(self, status: SuctionStatus) -> None:
        message = SuctionState(
            state=_CODES[status.phase],
            vacuum=float(status.reading.vacuum),
            part_present=status.reading.part_present,
            part_detached=status.reading.part_detached or status.phase is SuctionPhase.LOST,
            fault=status.phase is SuctionPhase.FAULT,
            message=status.message,
        )
        message.header.stamp = self.get_clock().now().to_msg()
        self._state.publish(message)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(SuctionNode, args)


if __name__ == "__main__":
    sys.exit(main())
