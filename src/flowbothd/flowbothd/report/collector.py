"""Listens to a running graph and keeps what a report needs."""

from __future__ import annotations

from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from flowbothd_common.motion import joint_order
from flowbothd_common.ros import qos
from flowbothd_common.ros.clouds import from_flow_message
from flowbothd_common.ros.conversions import from_result, from_xyz, to_seconds
from flowbothd_evaluation.run_record.record import (
    PredictionSample,
    RunRecord,
    StateSample,
    motion_entry,
)
from flowbothd_interfaces.msg import FlowPrediction, MotionResult, PolicyDecision, SimState


def decision_of(message: PolicyDecision) -> dict[str, Any]:
    """The decision that a PolicyDecision message carries, as the record keeps it."""
    return {
        "sequence": message.sequence,
        "time": to_seconds(message.header.stamp),
        "state": message.state,
        "event": message.event,
        "decision": message.decision,
        "reason": message.reason,
        "step": message.step,
        "grasps": message.grasps,
        "trials": message.trials,
        "prediction_stamp": to_seconds(message.prediction_stamp),
        "chosen_sample": message.chosen_sample,
        "grasp_point": from_xyz(message.grasp_point),
        "flow": from_xyz(message.flow),
        "tool_motion": from_xyz(message.tool_motion),
        "history_updated": message.history_updated,
        "grasp_switched": message.grasp_switched,
        "opening": message.opening,
        "outcome": message.outcome,
    }


class Collector:
    """Fills a RunRecord from the topics of a graph.

    States are kept as often as `sim/state` comes, with the newest joint states.

    Args:
        node: Gets the subscriptions.
        record: Is filled.
        arm_joints: Names in the order in which the record keeps them.
    """

    def __init__(self, node: Node, record: RunRecord, arm_joints: tuple[str, ...]) -> None:
        self._record, self._arm_joints = record, arm_joints
        self._arm: np.ndarray | None = None
        self.mode = ""
        self._subscriptions = [
            node.create_subscription(*entry)
            for entry in (
                (PolicyDecision, "policy/decisions", self._on_decision, qos.EVENT),
                (MotionResult, "motion/result", self._on_result, qos.EVENT),
                (FlowPrediction, "flow/prediction", self._on_prediction, qos.EVENT),
                (SimState, "sim/state", self._on_sim_state, qos.STATE),
                (JointState, "joint_states", self._on_joint_states, qos.STATE),
            )
        ]

    def _on_decision(self, message: PolicyDecision) -> None:
        self._record.decisions.append(decision_of(message))

    def _on_result(self, message: MotionResult) -> None:
        time = to_seconds(message.header.stamp)
        self._record.motions.append(motion_entry(from_result(message), time))

    def _on_prediction(self, message: FlowPrediction) -> None:
        if message.ok:
            points, flows = from_flow_message(message.flows)
            stamp = to_seconds(message.header.stamp)
            self._record.predictions.append(PredictionSample(stamp, points, flows))

    def _on_joint_states(self, message: JointState) -> None:
        order = joint_order(self._arm_joints, message.name)
        self._arm = np.array(message.position)[order]

    def _on_sim_state(self, message: SimState) -> None:
        self.mode = message.mode
        if self._arm is not None:
            self._record.states.append(
                StateSample(
                    to_seconds(message.header.stamp),
                    self._arm,
                    dict(zip(message.joint_names, message.positions, strict=True)),
                    message.open_ratio,
                )
            )
