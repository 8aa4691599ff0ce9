"""Shows a running graph in Rerun."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter

from flowbothd.view.camera import camera_pose
from flowbothd.view.run_view import RunView
from flowbothd_common.ros.node_main import run_node
from flowbothd_rosbag.graph_parameters_ros import GraphParameters, Values
from flowbothd_rosbag.qos_ros import listening
from flowbothd_rosbag.types_ros import message_class

_DEPTH = 20


class LiveView(Node):
    """Subscribes to what a view shows, as it appears.

    Args:
        recording: rerun.RecordingStream.
    """

    def __init__(self, recording: Any, **kwargs: Any) -> None:
        super().__init__("view_node", **kwargs)
        self._view = RunView(recording)
        self._hear: dict[str, Any] = {}
        self._graph = GraphParameters(self, self._on_parameters)
        self._timer = self.create_timer(0.5, self._look)

    def _look(self) -> None:
        self._graph.look()
        for name, kinds in self.get_topic_names_and_types():
            if name in self._hear or not self._view.wants(name, kinds[0]):
                continue
            offers = [offer.qos_profile for offer in self.get_publishers_info_by_topic(name)]
            if offers:
                self._hear[name] = self._listen(name, kinds[0], listening(offers, _DEPTH))

    def _listen(self, name: str, kind: str, profile: Any) -> Any:
        return self.create_subscription(
            message_class(kind), name, lambda message: self._view.show(name, message), profile
        )

    def _on_parameters(self, parameters: dict[str, Values]) -> None:
        for node, values in parameters.items():
            if node.endswith("perception_node"):
                self._view.camera = camera_pose(values)


def run(recording: Any) -> int:
    """Show until stopped."""

    def create() -> LiveView:
        wall = Parameter("use_sim_time", value=False)
        return LiveView(recording, parameter_overrides=[wall])

    return run_node(create)
