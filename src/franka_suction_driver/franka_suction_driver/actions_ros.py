"""The four motion actions: accepted goals in, results out, whenever they come."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from std_msgs.msg import Header

from flowbothd_common.motion import MotionKind, MotionReason, MotionResult
from flowbothd_common.ros import qos
from flowbothd_common.ros.conversions import to_result
from flowbothd_interfaces.action import Approach, FlowStep, Probe, Retreat
from flowbothd_interfaces.msg import MotionResult as MotionResultMessage

_ACTIONS = {
    MotionKind.APPROACH: Approach,
    MotionKind.PROBE: Probe,
    MotionKind.FLOW_STEP: FlowStep,
    MotionKind.RETREAT: Retreat,
}
_DONE = (MotionReason.REACHED, MotionReason.VACUUM)


class ActiveGoal:
    """One accepted goal.

    Attributes:
        kind: Which motion.
        request: The goal message.
    """

    def __init__(self, kind: MotionKind, handle: ServerGoalHandle) -> None:
        self.kind = kind
        self.handle = handle
        self.request = handle.request

    @property
    def key(self) -> bytes:
        """Identifies the goal."""
        return bytes(self.handle.goal_id.uuid)

    def feedback(self, fraction: float) -> None:
        """Tell the client how far the motion has come, 0..1."""
        self.handle.publish_feedback(_ACTIONS[self.kind].Feedback(fraction=fraction))


class MotionActions:
    """Action servers `motion/...` and the topic `motion/result`.

    A goal is held without a waiting callback, which would keep the executor's thread busy; its
    result is delivered when `finish` is called.

    Args:
        node: Serves on it.
        base_frame: Frame of all results.
        accept: Called with every goal.
        cancel: Called with the key of a goal to cancel; whether it is the running one.
    """

    def __init__(
        self,
        node: Node,
        base_frame: str,
        accept: Callable[[ActiveGoal], None],
        cancel: Callable[[bytes], bool],
    ) -> None:
        self._node = node
        self._frame = base_frame
        self._accept = accept
        self._cancel = cancel
        self._results: dict[bytes, MotionResult] = {}
        self._result = node.create_publisher(MotionResultMessage, "motion/result", qos.EVENT)
        self._servers = [self._serve(kind, action) for kind, action in _ACTIONS.items()]

    def destroy(self) -> None:
        """Stop serving; to be called before the node is destroyed."""
        for server in self._servers:
            server.destroy()

    def finish(self, goal: ActiveGoal, result: MotionResult) -> None:
        """Publish the result and deliver it to the goal's client."""
        self._result.publish(to_result(self._header(), result))
        self._node.get_logger().info(f"{goal.kind.value}: {result.reason.value} {result.message}")
        self._results[goal.key] = result
        goal.handle.execute()

    def _serve(self, kind: MotionKind, action: Any) -> ActionServer:
        return ActionServer(
            self._node,
            action,
            f"motion/{kind.value}",
            execute_callback=partial(self._deliver, action),
            handle_accepted_callback=lambda handle: self._accept(ActiveGoal(kind, handle)),
            cancel_callback=self._on_cancel,
        )

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        known = self._cancel(bytes(handle.goal_id.uuid))
        return CancelResponse.ACCEPT if known else CancelResponse.REJECT

    def _deliver(self, action: Any, handle: ServerGoalHandle) -> Any:
        result = self._results.pop(bytes(handle.goal_id.uuid))
        if handle.is_cancel_requested:
            handle.canceled()
        elif result.reason in _DONE:
            handle.succeed()
        else:
            handle.abort()
        return action.Result(result=to_result(self._header(), result))

    def _header(self) -> Header:
        return Header(stamp=self._node.get_clock().now().to_msg(), frame_id=self._frame)
