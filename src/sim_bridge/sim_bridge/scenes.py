"""Scenes: where an object stands, where the camera stands, when the object counts as open."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.transforms import look_at, quaternion_from_rotation, rotation_about, transform
from flowbothd_common.types import Array


@dataclass(frozen=True)
class Scene:
    """One object before the arm; everything in the base frame.

    Attributes:
        name: Scene name.
        object: Registered object, PartNet-Mobility folder or URDF file.
        position: (x, y, z) of the object's origin [m]; None = the object's own default pose.
        yaw: Rotation of the object about z [rad].
        camera_eye: Where the depth camera is [m].
        camera_target: What it looks at [m].
        report_eye: Where pictures for people are taken from [m].
        report_target: What is in their middle [m].
        policy: Parameters of the policy that this scene needs, such as the opening target.
    """

    name: str
    object: str
    position: tuple[float, ...] | None
    yaw: float
    camera_eye: tuple[float, ...]
    camera_target: tuple[float, ...]
    report_eye: tuple[float, ...]
    report_target: tuple[float, ...]
    policy: dict[str, Any]

    @property
    def T_base_object(self) -> Array | None:
        """(4, 4) pose of the object, or None for its default."""
        if self.position is None:
            return None
        return transform(rotation_about((0, 0, 1), self.yaw), self.position)

    @property
    def T_base_camera(self) -> Array:
        """(4, 4) pose of the camera's optical frame."""
        return look_at(self.camera_eye, self.camera_target)

    @property
    def camera_quaternion(self) -> list[float]:
        """Orientation of the camera's optical frame, xyzw."""
        return [float(v) for v in quaternion_from_rotation(self.T_base_camera[:3, :3])]


def _scene(name: str, entry: dict[str, Any]) -> Scene:
    pose = entry.get("pose")
    return Scene(
        name=name,
        object=entry.get("object", name),
        position=None if pose is None else tuple(float(v) for v in pose["position"]),
        yaw=0.0 if pose is None else float(np.radians(pose["yaw_deg"])),
        camera_eye=tuple(float(v) for v in entry["camera"]["eye"]),
        camera_target=tuple(float(v) for v in entry["camera"]["target"]),
        report_eye=tuple(float(v) for v in entry["report"]["eye"]),
        report_target=tuple(float(v) for v in entry["report"]["target"]),
        policy=dict(entry.get("policy", {})),
    )


def load_scenes() -> dict[str, Scene]:
    """All committed scenes by name."""
    text = files("sim_bridge").joinpath("scenes.yaml").read_text()
    return {name: _scene(name, entry) for name, entry in yaml.safe_load(text).items()}


def scene_for(name_or_path: str) -> Scene:
    """The committed scene of that name, or the default scene around a PartNet folder or URDF file.

    Raises:
        ObjectModelError: neither a scene nor a file.
    """
    scenes = load_scenes()
    if name_or_path in scenes:
        return scenes[name_or_path]
    path = Path(name_or_path).expanduser()
    if not path.exists():
        raise ObjectModelError(
            "unknown object",
            got=name_or_path,
            allowed=", ".join(sorted(set(scenes) - {"default"}))
            + ", a PartNet-Mobility folder, or a .urdf file",
        )
    default = scenes["default"]
    return replace(default, name=path.stem, object=str(path.resolve()))
