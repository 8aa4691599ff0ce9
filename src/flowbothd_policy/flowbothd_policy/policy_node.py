"""Runs the policy in the node graph: messages in, events to the core, commands out."""

from __future__ import annotations

import sys
import time
from collections import deque
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from flowbothd_common.ros import diagnostics, qos, received
from flowbothd_common.ros.conversions import to_seconds
from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.liveness import PeerWatch
from flowbothd_common.ros.node_main import run_node
from flowbothd_common.ros.parameters import declare
from flowbothd_common.types import Outcome, SuctionPhase
from flowbothd_interfaces.msg import PolicyDecision, SuctionState
from flowbothd_policy.actuators_ros import Actuators, to_decision_message
from flowbothd_policy.commands import (
    Command,
    Decision,
    Finish,
    Move,
    Predict,
    SetSuction,
    StopMotion,
)
from flowbothd_policy.events import (
    CloudArrived,
    Event,
    InputsBack,
    InputsLost,
    OperatorStop,
    Start,
    SuctionChanged,
    WaitExpired,
)
from flowbothd_policy.events_ros import EventLog, phase_of
from flowbothd_policy.params import PolicyNodeParams
from flowbothd_policy.state import Phase, PolicyState
from flowbothd_policy.state_machine import advance, waiting

_AT_REST = (Phase.IDLE, Phase.FINISHED)


class PolicyNode(Node):
    """Feeds the pure policy and carries out what it asks for."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("policy_node", **kwargs)
        self._params = declare(self, PolicyNodeParams)
        self._state = PolicyState()
        self._queue: deque[Event] = deque()
        self._busy = False
        self._wait: tuple[str, float] | None = None
        self._waiting_since = time.monotonic()
        self._lost: tuple[str, ...] = ()
        self._suction, self._outcome, self._started = SuctionPhase.OFF, "", False
        guard = Guard(self, self._on_failure)
        self._status = diagnostics.NodeStatus(self, guard)
        self._peers = PeerWatch(self, self._params.watch_nodes, self._params.watch_timeout)
        self._actuators = Actuators(
            self, self._feed, self._params.base_frame, guard, self._params.service_timeout
        )
        self._events = EventLog(self, self._params.base_frame)
        self._decisions = self.create_publisher(PolicyDecision, "policy/decisions", qos.EVENT)
        guard.subscribe(PointCloud2, "object_cloud", self._on_cloud, qos.IMAGE)
        guard.subscribe(SuctionState, "suction/state", self._on_suction, qos.STATE)
        guard.serve(Trigger, "policy/start", self._on_start)
        guard.serve(Trigger, "policy/stop", self._on_stop)
        guard.every(0.05, self._on_timer)

    def destroy_node(self) -> None:
        """Stop the heartbeat before its publisher goes."""
        self._status.close()
        self._actuators.close()
        super().destroy_node()

    def _on_failure(self, why: str) -> None:
        """Stop the arm and end the run, with the pump off, after an unexpected exception."""
        self._actuators.stop()
        self._queue.clear()
        try:
            self._feed(OperatorStop(f"internal error: {why}", opened=False))
        except Exception:
            self._state, self._wait = PolicyState(), None
            self._outcome = f"{Outcome.ABORTED.value}: internal error: {why}"
            self._actuators.set_suction(0.0)
            raise

    def _feed(self, event: Event) -> None:
        """Carry the policy over an event, and over those that its commands bring about."""
        self._queue.append(event)
        if self._busy:
            return
        self._busy = True
        try:
            while self._queue:
                self._advance(self._queue.popleft())
        finally:
            self._busy = False

    def _advance(self, event: Event) -> None:
        event, now = self._events.note(event)
        self._state, commands = advance(self._state, event, now, self._params)
        wait = waiting(self._state, self._params)
        if commands or wait != self._wait:
            self._wait, self._waiting_since = wait, time.monotonic()
        for command in commands:
            self._carry_out(command)

    def _carry_out(self, command: Command) -> None:
        if isinstance(command, Decision):
            self._decisions.publish(to_decision_message(command, self._params.base_frame))
            log = self.get_logger()
            tell = log.debug if command.decision == "resample" else log.info
            tell(f"{command.state}: {command.decision}: {command.reason}")
        elif isinstance(command, Predict):
            self._actuators.predict(command)
        elif isinstance(command, Move):
            self._actuators.move(command.goal)
        elif isinstance(command, SetSuction):
            self._actuators.set_suction(command.vacuum)
        elif isinstance(command, StopMotion):
            self._actuators.stop()
        elif isinstance(command, Finish):
            self._outcome = f"{command.outcome.value}: {command.reason}"

    def _on_cloud(self, message: PointCloud2) -> None:
        stamp = to_seconds(message.header.stamp)
        if self._state.phase is not Phase.OBSERVING or stamp <= self._state.observe_after:
            return
        received.not_ahead(stamp, self.get_clock().now().nanoseconds * 1e-9)
        points = received.object_cloud(message, self._params.base_frame)
        self._feed(CloudArrived(points, stamp))

    def _on_suction(self, message: SuctionState) -> None:
        phase = phase_of(message.state)
        if phase is not self._suction:
            self._suction = phase
            self._feed(SuctionChanged(phase, message.message))

    def _on_start(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        missing = self._missing()
        if self._state.phase not in _AT_REST:
            response.message = f"a run is under way ({self._state.phase.value}); stop it first"
        elif missing:
            response.message = f"cannot start, missing: {', '.join(missing)}"
        else:
            self._begin()
            response.success, response.message = True, "started"
        return response

    def _begin(self) -> None:
        self._started, self._outcome = True, ""
        self._feed(Start())

    def _on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._state.phase not in _AT_REST
        self._feed(OperatorStop("policy/stop was called"))
        response.message = self._outcome or "no run was under way"
        return response

    def _missing(self) -> list[str]:
        """Inputs and peers that are missing now, in words."""
        # Without the growing age of a silence: what is said changes only with what is missing.
        peers = [f"{name} ({why.split(' for ')[0]})" for name, why in self._peers.missing().items()]
        return peers or self._actuators.missing()

    def _on_timer(self) -> None:
        missing = tuple(self._missing())
        names = tuple(entry.split(" ")[0] for entry in missing)
        running = self._state.phase not in _AT_REST
        if running and missing and names != self._lost:
            self._feed(InputsLost(missing))
        elif running and not missing and self._lost:
            self._feed(InputsBack())
        self._lost = names if running else ()
        if self._params.autostart and not self._started and not missing:
            self._begin()
        if self._wait is not None and time.monotonic() - self._waiting_since > self._wait[1]:
            self._waiting_since = time.monotonic()
            self._feed(WaitExpired())
        if missing:
            self._status.report(diagnostics.ERROR, f"missing: {', '.join(missing)}")
        else:
            self._status.report(diagnostics.OK, self._outcome or ("running" if running else "idle"))


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(PolicyNode, args)


if __name__ == "__main__":
    sys.exit(main())
