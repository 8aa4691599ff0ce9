"""Messages of a run into a Rerun recording, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flowbothd.view import entities as at
from flowbothd.view.camera import thinned_cloud
from flowbothd.view.robot import RobotPoses
from flowbothd_common.ros import clouds
from flowbothd_common.ros.conversions import from_xyz, to_seconds
from flowbothd_common.types import Array, Cloud

_ARROWS = 160
"""Points of a flow field that get an arrow."""

_ARROW_LENGTH = 0.12
"""Length of the arrow of the largest flow [m]."""

_EPOCH = 1e8
"""Stamps beyond this are wall time, others simulated time [s]."""

_PERIODS = {
    "joint_states": 1 / 15,
    "external_wrench": 1 / 25,
    "suction/state": 1 / 25,
    "depth/image_raw": 0.6,
    "object_cloud": 0.3,
    "sim/state": 0.1,
    "debug/robot": 0.3,
    "debug/outliers": 0.3,
}
"""Least time between two that are shown [s]; a screen shows no more, and files stay small."""

_TYPES = {
    "robot_description": "std_msgs/msg/String",
    "joint_states": "sensor_msgs/msg/JointState",
    "depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "depth/image_raw": "sensor_msgs/msg/Image",
    "object_cloud": "sensor_msgs/msg/PointCloud2",
    "debug/robot": "sensor_msgs/msg/PointCloud2",
    "debug/outliers": "sensor_msgs/msg/PointCloud2",
    "flow/prediction": "flowbothd_interfaces/msg/FlowPrediction",
    "policy/decisions": "flowbothd_interfaces/msg/PolicyDecision",
    "suction/state": "flowbothd_interfaces/msg/SuctionState",
    "external_wrench": "geometry_msgs/msg/WrenchStamped",
    "sim/state": "flowbothd_interfaces/msg/SimState",
}
"""What is shown; a topic of the same name and another type is somebody else's."""


class RunView:
    """Shows a run.

    Args:
        recording: rerun.RecordingStream.
        camera: (4, 4) T_base_camera; None = camera points cannot be shown.

    Attributes:
        camera: As given; may be set as soon as it becomes known.
    """

    def __init__(self, recording: Any, camera: Array | None = None) -> None:
        import rerun as rr

        self._rr, self._rec, self.camera = rr, recording, camera
        self._robot: RobotPoses | None = None
        self._links: dict[str, Any] = {}
        self._path: list[Array] = []
        self._info: Any = None
        self._flows: dict[tuple[int, int], tuple[Cloud, NDArray[np.float32]]] = {}
        self._shown: dict[str, float] = {}
        self._handlers: dict[str, Callable[[Any], None]] = {
            "robot_description": self._on_description,
            "joint_states": self._on_joints,
            "depth/camera_info": self._on_info,
            "depth/image_raw": self._on_depth,
            "object_cloud": self._on_object,
            "debug/robot": lambda m: self._on_removed("robot", m),
            "debug/outliers": lambda m: self._on_removed("outliers", m),
            "flow/prediction": self._on_prediction,
            "policy/decisions": self._on_decision,
            "suction/state": self._on_suction,
            "external_wrench": self._on_wrench,
            "sim/state": self._on_sim,
        }
        self._log(at.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._style()

    @property
    def topics(self) -> tuple[tuple[str, str], ...]:
        """Ends of the names of topics that are shown, and their types."""
        return tuple(_TYPES.items())

    def wants(self, topic: str, kind: str) -> bool:
        """Return True if a topic of this type is shown."""
        name = self._name(topic)
        return name is not None and kind == _TYPES[name]

    def show(self, topic: str, message: Any) -> None:
        """Show a message, unless one of its kind was shown just before."""
        name = self._name(topic)
        if name is None:
            return
        if hasattr(message, "header"):
            now = to_seconds(message.header.stamp)
            last = self._shown.get(name, float("-inf"))
            if 0 <= now - last < _PERIODS.get(name, 0.0):
                return
            self._shown[name] = now
            self._set_time(now)
        self._handlers[name](message)

    def _name(self, topic: str) -> str | None:
        return next((n for n in self._handlers if topic == n or topic.endswith("/" + n)), None)

    def _set_time(self, now: float) -> None:
        if now > _EPOCH:
            self._rec.set_time("time", timestamp=now)
        else:
            self._rec.set_time("time", duration=now)

    def _log(self, path: str, *what: Any, static: bool = False) -> None:
        self._rec.log(path, *what, static=static)

    def _style(self) -> None:
        rr = self._rr
        for path, names, colors in (
            (f"{at.OPENING}/by_tool", "judged from the tool's path", (90, 160, 220)),
            (f"{at.OPENING}/true", "true (simulation)", (70, 190, 110)),
            (f"{at.TRIALS}/rejected", "rejected samples", (150, 120, 190)),
            (f"{at.VACUUM}/measured", "vacuum", (90, 160, 220)),
            (f"{at.FORCE}/norm", "force", (220, 120, 60)),
        ):
            self._log(path, rr.SeriesLines(colors=colors, names=names), static=True)
        table = rr.Boxes3D(
            centers=[[0.4, 0.0, -0.02]],
            half_sizes=[[0.85, 0.85, 0.02]],
            colors=[[70, 68, 65]],
            fill_mode="solid",
        )
        self._log(at.TABLE, table, static=True)

    def _on_description(self, message: Any) -> None:
        from sim_bridge.surroundings import robot_meshes

        rr = self._rr
        self._robot = RobotPoses(message.data)
        self._links = dict(robot_meshes(message.data))
        for link, meshes in self._links.items():
            for number, mesh in enumerate(meshes):
                shown = rr.Mesh3D(
                    vertex_positions=np.asarray(mesh.vertices, np.float32),
                    triangle_indices=np.asarray(mesh.faces, np.uint32),
                    vertex_normals=_normals(mesh.vertices, mesh.faces),
                    albedo_factor=_rgba(mesh.color),
                )
                self._log(f"{at.ROBOT}/{link}/{number}", shown, static=True)

    def _on_joints(self, message: Any) -> None:
        if self._robot is None:
            return
        self._robot.move(message.name, message.position)
        for link in self._links:
            pose = self._robot.pose(link)
            transform = self._rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3])
            self._log(f"{at.ROBOT}/{link}", transform)
        tip = self._robot.tip()
        if tip is not None and (
            not self._path or float(np.linalg.norm(tip - self._path[-1])) > 0.004
        ):
            self._path.append(tip)
            strip = self._rr.LineStrips3D(
                [np.array(self._path[-600:])], colors=[250, 210, 60], radii=0.0015
            )
            self._log(at.PATH, strip)

    def _on_info(self, message: Any) -> None:
        self._info = message

    def _on_depth(self, message: Any) -> None:
        if self._info is None or self.camera is None:
            return
        points = thinned_cloud(message, self._info, self.camera)
        self._log(at.CAMERA, self._rr.Points3D(points, colors=[150, 150, 155], radii=0.002))

    def _on_object(self, message: Any) -> None:
        points = clouds.from_cloud_message(message, clouds.XYZ).reshape(-1, 3)
        self._log(at.OBJECT, self._rr.Points3D(points, colors=[90, 200, 120], radii=0.0035))

    def _on_removed(self, stage: str, message: Any) -> None:
        path, color = at.REMOVED[stage]
        points = clouds.from_cloud_message(message, clouds.XYZ).reshape(-1, 3)
        self._log(path, self._rr.Points3D(points, colors=color, radii=0.0025))

    def _on_prediction(self, message: Any) -> None:
        if not message.ok:
            return
        points, flows = clouds.from_flow_message(message.flows)
        stamp = message.header.stamp
        self._flows = {(stamp.sec, stamp.nanosec): (points, flows)}
        chosen = _spread(len(points))
        vectors = flows[:, chosen].reshape(-1, 3) * _ARROW_LENGTH
        origins = np.tile(points[chosen], (len(flows), 1))
        faint = self._rr.Arrows3D(
            origins=origins, vectors=vectors, colors=[120, 200, 255, 70], radii=0.0008
        )
        self._log(at.SAMPLES, faint)

    def _on_decision(self, message: Any) -> None:
        rr = self._rr
        worth = "DEBUG" if message.decision == "resample" else "INFO"
        if message.outcome:
            worth = "WARN"
        text = f"{message.decision}: {message.reason}"
        self._log(at.DECISIONS, rr.TextLog(text, level=worth))
        if hasattr(rr, "StateChange"):
            self._log(f"{at.PHASE}/state", rr.StateChange(state=message.state))
        self._log(f"{at.OPENING}/by_tool", rr.Scalars(message.opening))
        self._log(f"{at.TRIALS}/rejected", rr.Scalars(float(message.trials)))
        if message.chosen_sample >= 0:
            self._show_choice(message)

    def _show_choice(self, message: Any) -> None:
        rr = self._rr
        stamp = message.prediction_stamp
        points, flows = self._flows.get((stamp.sec, stamp.nanosec), (None, None))
        if points is not None and flows is not None and message.chosen_sample < len(flows):
            chosen = _spread(len(points))
            bold = rr.Arrows3D(
                origins=points[chosen],
                vectors=flows[message.chosen_sample, chosen] * _ARROW_LENGTH,
                colors=[60, 230, 110],
                radii=0.0016,
            )
            self._log(at.CHOSEN, bold)
        grasp, pull = from_xyz(message.grasp_point), from_xyz(message.flow)
        self._log(at.GRASP, rr.Points3D([grasp], colors=[230, 50, 50], radii=0.012))
        arrow = rr.Arrows3D(
            origins=[grasp], vectors=[2 * _ARROW_LENGTH * pull], colors=[230, 50, 50], radii=0.005
        )
        self._log(at.PULL, arrow)

    def _on_suction(self, message: Any) -> None:
        self._log(f"{at.VACUUM}/measured", self._rr.Scalars(message.vacuum / 1000))

    def _on_wrench(self, message: Any) -> None:
        force = float(np.linalg.norm(from_xyz(message.wrench.force)))
        self._log(f"{at.FORCE}/norm", self._rr.Scalars(force))

    def _on_sim(self, message: Any) -> None:
        self._log(f"{at.OPENING}/true", self._rr.Scalars(message.open_ratio))


def _spread(count: int) -> NDArray[np.intp]:
    """Indices of points that get an arrow."""
    return np.unique(np.linspace(0, count - 1, min(count, _ARROWS)).astype(np.intp))


def _normals(vertices: Any, faces: Any) -> NDArray[np.float32]:
    """(V, 3) unit normals, averaged over the faces of each vertex."""
    corners = np.asarray(vertices, float)[np.asarray(faces, np.intp)]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    summed = np.zeros((len(vertices), 3))
    for corner in range(3):
        np.add.at(summed, np.asarray(faces, np.intp)[:, corner], flat)
    lengths = np.linalg.norm(summed, axis=1, keepdims=True)
    return np.asarray(summed / np.maximum(lengths, 1e-12), dtype=np.float32)


def _rgba(color: Any) -> list[int]:
    """Colour of a link, toned down: white plastic would drown in the viewer's light."""
    given = (0.8, 0.82, 0.86) if color is None else [float(c) for c in list(color)[:3]]
    return [*(round(170 * c) for c in given), 255]
