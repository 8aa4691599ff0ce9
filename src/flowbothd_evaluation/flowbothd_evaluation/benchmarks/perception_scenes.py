"""Frames of the simulated camera whose every pixel is known: arm, object, table, or flying."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio
from numpy.typing import NDArray

from flowbothd_common.transforms import look_at, rotation_about, transform
from flowbothd_common.types import Array
from flowbothd_perception.params import RobotFilterParams
from flowbothd_perception.robot_filter import RobotFilter
from sim_bridge.camera import DepthCamera, Intrinsics
from sim_bridge.depth_noise import DepthNoise, disturb
from sim_bridge.objects.model import ObjectModel
from sim_bridge.objects.registry import load_object
from sim_bridge.scene import Part
from sim_bridge.surroundings import robot_meshes, static_parts

OBJECTS: tuple[tuple[str, str, int], ...] = (
    ("custom_door", "pull_left", 0),
    ("custom_door", "push_right", 0),
    ("cabinet_door", "left", 0),
    ("cabinet_door", "right", 1),
    ("cabinet_door", "left", 2),
    ("drawer", "", 0),
    ("drawer", "", 1),
    ("drawer", "", 2),
    ("lidded_box", "", 0),
    ("lidded_box", "", 1),
)
"""Name, mode and seed of the proportions of the objects that the arm poses in front of."""

NOTHING, SURROUNDINGS, ROBOT, OBJECT = 0, 1, 2, 3

_LOWER = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
_UPPER = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
_HOME = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])


@dataclass(frozen=True)
class Mount:
    """Where the camera hangs, and how it is turned about its view axis.

    Attributes:
        name: For tables.
        eye: Position in base [m].
        target: What it looks at [m].
        roll_deg: Turn about the optical axis.
    """

    name: str
    eye: tuple[float, float, float]
    target: tuple[float, float, float] = (0.45, 0.0, 0.3)
    roll_deg: float = 0.0

    @property
    def T_base_camera(self) -> Array:
        """(4, 4) pose of the optical frame."""
        turn = transform(rotation_about((0, 0, 1), np.radians(self.roll_deg)))
        return np.asarray(look_at(self.eye, self.target) @ turn)


MOUNTS = (
    Mount("right", (0.55, -1.1, 0.65)),
    Mount("left (mirrored)", (0.55, 1.1, 0.65)),
    Mount("right, on its side", (0.55, -1.1, 0.65), roll_deg=90.0),
    Mount("right, upside down", (0.55, -1.1, 0.65), roll_deg=180.0),
    Mount("behind, above", (0.0, -0.9, 0.9)),
)
"""The same view, mirrored and turned, and the furniture scenes' camera."""


@dataclass(frozen=True)
class TruthFrame:
    """One picture and what it shows.

    Attributes:
        depth: (H, W) float32 z [m], disturbed as asked; 0 = nothing measured.
        exact: (H, W) float32 z [m] before any disturbance; 0 = nothing there.
        owner: (H, W) int8, one of NOTHING, SURROUNDINGS, ROBOT, OBJECT.
        flying: (H, W) whether the pixel was moved off its surface.
        joint_positions: (J,) of the arm.
        mount: The camera's true mount.
        name: Of the object.
    """

    depth: NDArray[np.float32]
    exact: NDArray[np.float32]
    owner: NDArray[np.int8]
    flying: NDArray[np.bool_]
    joint_positions: Array
    mount: Mount
    name: str


def random_arm_pose(rng: np.random.Generator) -> Array:
    """(7,) around the home pose, or anywhere within the joint limits, one as often as the other."""
    if rng.random() < 0.5:
        return np.clip(_HOME + rng.uniform(-0.8, 0.8, 7), _LOWER, _UPPER)
    return np.asarray(rng.uniform(_LOWER, _UPPER))


class TruthScenes:
    """The arm in random poses before objects that stand open at random.

    Args:
        urdf: The robot description.
        objects: Name (or file), mode and seed of each.
        mounts: Of the camera; they take turns.
        noise: Of the depths; None for exact ones.
        lens: Of the camera.
    """

    def __init__(
        self,
        urdf: str,
        objects: Sequence[tuple[str, str, int]] = OBJECTS,
        mounts: Sequence[Mount] = MOUNTS,
        noise: DepthNoise | None = None,
        lens: Intrinsics | None = None,
    ) -> None:
        self._urdf, self._noise, self._mounts = urdf, noise, tuple(mounts)
        self._models = [load_object(name, mode=mode or None, seed=s) for name, mode, s in objects]
        self._model = pinocchio.buildModelFromXML(urdf)
        self._data = self._model.createData()
        bare = RobotFilterParams(padding=0.0, padded_links=(), paddings=())
        self._solid = RobotFilter(urdf, bare)
        self.lens = lens or Intrinsics()

    def frames(self, count: int, seed: int = 0) -> Iterator[TruthFrame]:
        """Take `count` pictures; the same seed gives the same ones."""
        rng = np.random.default_rng(seed)
        cameras = [DepthCamera((), m.T_base_camera, self.lens) for m in self._mounts]
        for index in range(count):
            model = self._models[index * len(self._models) // count]
            camera_index = index % len(self._mounts)
            camera, mount = cameras[camera_index], self._mounts[camera_index]
            parts, poses = self._object(model, rng)
            q = self._free_pose(parts, poses, rng)
            camera.set_parts((*static_parts(self._urdf), *parts))
            yield self._picture(camera, {**poses, **self._robot_poses(q)}, q, mount, model, rng)

    def still_life(self, count: int, seed: int = 0) -> Iterator[TruthFrame]:
        """Pictures in which only the arm moves, near its home pose: for calibration."""
        rng = np.random.default_rng(seed)
        model, mount = self._models[0], self._mounts[0]
        parts, poses = self._object(model, rng)
        camera = DepthCamera((), mount.T_base_camera, self.lens)
        camera.set_parts((*static_parts(self._urdf), *parts))
        while count:
            q = _HOME + rng.uniform(-0.6, 0.6, 7)
            if self._robot_poses(q)["robot/suction_cup"][2, 3] > 0.1:
                count -= 1
                arm = self._robot_poses(q)
                yield self._picture(camera, {**poses, **arm}, q, mount, model, rng)

    def _object(
        self, model: ObjectModel, rng: np.random.Generator
    ) -> tuple[tuple[Part, ...], dict[str, Array]]:
        positions = {
            joint.name: joint.lower + rng.random() * (joint.upper - joint.lower)
            for joint in model.joints.values()
        }
        parts = tuple(Part(f"object/{name}", link.meshes) for name, link in model.links.items())
        moved = model.displacements(positions)
        return parts, {f"object/{name}": model.default_pose @ m for name, m in moved.items()}

    def _free_pose(
        self, parts: Sequence[Part], poses: dict[str, Array], rng: np.random.Generator
    ) -> Array:
        """Arm pose in which the arm is neither in the object nor in the table."""
        surface = np.concatenate([_surface(part, poses[part.name], rng) for part in parts])
        while True:
            q = random_arm_pose(rng)
            heights = [pose[2, 3] for pose in self._robot_poses(q).values()]
            if sorted(heights)[1] > 0.06 and not self._solid.on_robot(surface, q).any():
                return q

    def _robot_poses(self, q: Array) -> dict[str, Array]:
        pinocchio.framesForwardKinematics(self._model, self._data, q)
        return {
            f"robot/{name}": self._data.oMf[self._model.getFrameId(name)].homogeneous
            for name in robot_meshes(self._urdf)
        }

    def _picture(
        self,
        camera: DepthCamera,
        poses: dict[str, Array],
        q: Array,
        mount: Mount,
        model: ObjectModel,
        rng: np.random.Generator,
    ) -> TruthFrame:
        image = camera.render({"table": np.eye(4), **poses})
        exact = image.depth
        owner = np.where(image.labels >= 0, SURROUNDINGS, NOTHING).astype(np.int8)
        owner[image.mask("robot/")] = ROBOT
        owner[image.mask("object/")] = OBJECT
        depth, flying = exact, np.zeros(exact.shape, dtype=bool)
        if self._noise is not None:
            deep = np.where(exact > 0, exact, np.float32(np.inf))
            edges = DepthNoise(0.0, 0.0, self._noise.flying_fraction, self._noise.edge_step)
            flown = disturb(deep, edges, rng)
            flying = flown != deep
            still = DepthNoise(self._noise.sigma, self._noise.sigma_per_m2)
            noisy = disturb(flown, still, rng)
            depth = np.where(np.isfinite(noisy), noisy, np.float32(0))
        return TruthFrame(depth, exact, owner, flying, q, mount, f"{model.name} {model.seed}")


def _surface(part: Part, pose: Array, rng: np.random.Generator) -> NDArray[np.float32]:
    """(N, 3) points on a part, in base, a centimetre or so apart."""
    mesh = part.mesh.transformed(pose)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1) / 2
    count = int(np.clip(area.sum() * 1e4, 100, 6000))
    chosen = rng.choice(len(area), count, p=area / area.sum())
    a, b = rng.random((2, count, 1))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    c = corners[chosen]
    points = c[:, 0] + a * (c[:, 1] - c[:, 0]) + b * (c[:, 2] - c[:, 0])
    return np.asarray(points, dtype=np.float32)
