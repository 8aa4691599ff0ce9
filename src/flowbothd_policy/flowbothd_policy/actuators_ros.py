"""The policy node's way to motion, suction and inference: asks by futures, never spins."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from flowbothd_common.errors import FlowBotError, InvalidMessageError
from flowbothd_common.motion import MotionGoal, MotionKind, MotionReason, MotionResult
from flowbothd_common.ros import clouds, received
from flowbothd_common.ros.conversions import (
    to_joint_estimate,
    to_point,
    to_stamp,
    to_vector3,
)
from flowbothd_common.ros.guard import Guard
from flowbothd_common.types import SuctionPhase
from flowbothd_interfaces.action import Approach, FlowStep, Probe, Retreat
from flowbothd_interfaces.msg import PolicyDecision
from flowbothd_interfaces.srv import PredictFlow, SetSuction
from flowbothd_policy.commands import Decision, Predict
from flowbothd_policy.events import (
    Event,
    MotionFinished,
    PredictionArrived,
    PredictionFailed,
    SuctionChanged,
)

_ACTIONS = {
    MotionKind.APPROACH: Approach,
    MotionKind.PROBE: Probe,
    MotionKind.FLOW_STEP: FlowStep,
    MotionKind.RETREAT: Retreat,
}


class Actuators:
    """Carries the policy's commands out; every answer comes back as an event.

    Args:
        node: Whose executor serves the futures.
        emit: Takes the events.
        base_frame: Frame of all goals.
        guard: Of the node's callbacks.
        timeout: Longest wait for an answer of the suction and stop services, steady clock [s].
    """

    def __init__(
        self,
        node: Node,
        emit: Callable[[Event], None],
        base_frame: str,
        guard: Guard,
        timeout: float,
    ) -> None:
        self._node, self._emit, self._base_frame = node, emit, base_frame
        self._guard, self._timeout = guard, timeout
        self._motions = {
            kind: ActionClient(node, action, f"motion/{kind.value}")
            for kind, action in _ACTIONS.items()
        }
        self._stop = node.create_client(Trigger, "motion/stop")
        self._suction = node.create_client(SetSuction, "suction/set")
        self._predict = node.create_client(PredictFlow, "predict_flow")
        self._goal_number = 0
        self._request_number = 0

    def missing(self) -> list[str]:
        """Names of services and actions that are not served."""
        services = {
            "motion/stop": self._stop.service_is_ready(),
            "suction/set": self._suction.service_is_ready(),
            "predict_flow": self._predict.service_is_ready(),
        }
        actions = {
            f"motion/{kind.value}": client.server_is_ready()
            for kind, client in self._motions.items()
        }
        return [name for name, ready in {**services, **actions}.items() if not ready]

    def close(self) -> None:
        """Give up the action clients, which the node does not destroy by itself."""
        for client in self._motions.values():
            client.destroy()

    def move(self, goal: MotionGoal) -> None:
        """Send a goal; its result replaces that of every goal before."""
        self._goal_number += 1
        number, client = self._goal_number, self._motions[goal.kind]
        if not client.server_is_ready():
            self._refused(goal.kind, f"action motion/{goal.kind.value} is not there")
            return

        def accepted(future: Future) -> None:
            handle = future.result()
            if number != self._goal_number:
                return
            if handle is None or not handle.accepted:
                self._refused(goal.kind, "motion_node did not accept the goal")
            else:
                result = handle.get_result_async()
                result.add_done_callback(partial(self._guard.run, "motion result", finished))

        def finished(future: Future) -> None:
            # A result of a goal given up meanwhile, by a pause for instance, means nothing now.
            if number != self._goal_number:
                return
            try:
                result = received.motion_result(future.result().result.result)
            except InvalidMessageError as error:
                self._guard.refuse("motion result", str(error))
                self._refused(goal.kind, str(error))
                return
            self._emit(MotionFinished(result))

        sent = client.send_goal_async(self._goal(goal))
        sent.add_done_callback(partial(self._guard.run, "motion goal", accepted))

    def stop(self) -> None:
        """Ask the arm to stop."""
        if self._stop.service_is_ready():
            self._call(self._stop, Trigger.Request(), lambda _: None)

    def _call(self, client: Client, request: Any, answered: Callable[[Any], None]) -> None:
        """Call a service; `answered` gets the response, or None if none comes in time."""
        waiting = client.call_async(request)
        name = str(client.srv_name)

        def late() -> None:
            self._node.destroy_timer(limit)
            if not waiting.done():
                client.remove_pending_request(waiting)
                self._guard.refuse(name, f"no answer within {self._timeout:g} s")
                answered(None)

        def done(future: Future) -> None:
            self._node.destroy_timer(limit)
            answered(future.result())

        limit = self._guard.every(self._timeout, late)
        waiting.add_done_callback(partial(self._guard.run, name, done))

    def set_suction(self, vacuum: float) -> None:
        """Ask for a vacuum; a refusal comes back as a pump fault."""
        if not self._suction.service_is_ready():
            self._emit(SuctionChanged(SuctionPhase.FAULT, "service suction/set is not there"))
            return

        def answered(response: SetSuction.Response | None) -> None:
            if response is None:
                why = f"no answer from suction/set within {self._timeout:g} s"
                self._emit(SuctionChanged(SuctionPhase.FAULT, why))
            elif not response.success:
                self._emit(SuctionChanged(SuctionPhase.FAULT, response.message))

        self._call(self._suction, SetSuction.Request(vacuum=float(vacuum)), answered)

    def predict(self, command: Predict) -> None:
        """Ask for samples."""
        self._request_number += 1
        number = self._request_number
        header = self._header(command.stamp)
        request = PredictFlow.Request(
            cloud=clouds.to_cloud_message(header, command.points, clouds.XYZ),
            history=clouds.to_history_message(header, command.history),
            samples=command.samples,
            seed=command.seed,
        )

        def answered(future: Future) -> None:
            if number == self._request_number:
                self._emit(_prediction(future.result(), command))

        if self._predict.service_is_ready():
            asked = self._predict.call_async(request)
            asked.add_done_callback(partial(self._guard.run, "predict_flow", answered))
        else:
            self._emit(PredictionFailed("service predict_flow is not there"))

    def _header(self, stamp: float) -> Header:
        return Header(frame_id=self._base_frame, stamp=to_stamp(stamp))

    def _goal(self, goal: MotionGoal) -> Any:
        message = _ACTIONS[goal.kind].Goal()
        message.header.frame_id = self._base_frame
        message.header.stamp = self._node.get_clock().now().to_msg()
        if goal.contact is not None and hasattr(message, "contact"):
            message.contact = to_point(goal.contact)
        if goal.direction is not None and hasattr(message, "direction"):
            message.direction = to_vector3(goal.direction)
        if hasattr(message, "joint"):
            message.joint = to_joint_estimate(goal.joint)
        if hasattr(message, "distance"):
            message.distance = float(goal.distance)
        if hasattr(message, "max_distance"):
            message.max_distance = float(goal.distance)
        return message

    def _refused(self, kind: MotionKind, message: str) -> None:
        self._emit(MotionFinished(MotionResult(kind, MotionReason.REJECTED, message)))


def _prediction(response: PredictFlow.Response | None, command: Predict) -> Event:
    if response is None:
        return PredictionFailed("the inference service went away")
    if not response.ok:
        return PredictionFailed(response.message)
    try:
        points, flows = clouds.from_flow_message(response.flows)
    except FlowBotError as error:
        return PredictionFailed(str(error))
    if points.shape != command.points.shape or not np.isfinite(flows).all():
        return PredictionFailed(f"flow for {len(points)} points, {len(command.points)} were asked")
    return PredictionArrived(points, flows, command.stamp, response.model_id, command.seed)


def to_decision_message(decision: Decision, base_frame: str) -> PolicyDecision:
    """Return the PolicyDecision message of a decision."""
    return PolicyDecision(
        header=Header(frame_id=base_frame, stamp=to_stamp(max(decision.time, 0.0))),
        sequence=decision.sequence,
        state=decision.state,
        event=decision.event,
        decision=decision.decision,
        reason=decision.reason,
        step=decision.step,
        grasps=decision.grasps,
        trials=decision.trials,
        prediction_stamp=to_stamp(decision.prediction_stamp),
        chosen_sample=decision.chosen_sample,
        grasp_point=to_point(decision.grasp_point),
        flow=to_vector3(decision.flow),
        tool_motion=to_vector3(decision.tool_motion),
        opening=float(decision.opening),
        history_updated=decision.history_updated,
        grasp_switched=decision.grasp_switched,
        outcome=decision.outcome,
    )
