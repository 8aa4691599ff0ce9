"""A world with its camera that can be set up and set up again; the ROS-free part of the bridge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.transforms import rotation_about, rotation_from_quaternion, transform
from flowbothd_common.types import Array
from sim_bridge.camera import DepthCamera
from sim_bridge.objects import ObjectModel, load_object
from sim_bridge.params import BridgeParams
from sim_bridge.world import ArmWorld


@dataclass(frozen=True)
class Setup:
    """Object in front of the arm.

    Attributes:
        object: Registered name, folder or file.
        mode: Empty = drawn from the seed.
        target_joint: Empty = the object's own choice.
        pose: T_base_object; None = the object's default.
        seed: Of mode, proportions and depth noise.
    """

    object: str
    mode: str = ""
    target_joint: str = ""
    pose: Array | None = None
    seed: int = 0

    def load(self) -> ObjectModel:
        """Load the object.

        Raises:
            ObjectModelError: a pose that is not finite; see load_object, ObjectModel.with_target.
        """
        if self.pose is not None and not np.isfinite(self.pose).all():
            raise ObjectModelError("pose of the object is not finite", got=self.pose[:3, 3])
        model = load_object(self.object, mode=self.mode or None, seed=self.seed)
        return model.with_target(self.target_joint) if self.target_joint else model


def initial_setup(params: BridgeParams) -> Setup:
    """Return the setup that the parameters describe."""
    pose = None
    if params.object_position:
        pose = transform(rotation_about((0, 0, 1), params.object_yaw), params.object_position)
    return Setup(params.object, params.mode, params.target_joint, pose, params.seed)


class Session:
    """One world and its camera over several resets.

    Simulated time goes on over resets, so that clocks never run backwards.
    """

    def __init__(self, robot_urdf: str, params: BridgeParams, setup: Setup) -> None:
        """Build world and camera.

        Raises:
            FlowBotError: the robot's URDF or the object cannot be used; says why.
        """
        self.setup = setup
        model = setup.load()
        self.world = ArmWorld(robot_urdf, model, setup.pose, params.arm)
        lens = params.camera
        camera_pose = transform(rotation_from_quaternion(lens.quaternion), lens.position)
        self.camera = DepthCamera(
            self.world.parts(), camera_pose, lens.intrinsics, lens.depth_noise, setup.seed
        )
        # ROS takes a stamp of zero for "not set".
        self._before = 1.0

    @property
    def time(self) -> float:
        """Simulated time over all resets [s]."""
        return self._before + self.world.time

    def world_time(self, stamp: float) -> float:
        """Time of the world for a time of this session [s]."""
        return stamp - self._before

    def reset(self, setup: Setup) -> None:
        """Put another object, or the same one again, closed; the arm goes to its start pose.

        Raises:
            ObjectModelError: the object cannot be used; the present world stays as it is.
        """
        model = setup.load()
        now = self.time
        self.world.reset(model, setup.pose)
        self._before = now + self.world.params.time_step
        self.setup = setup
        self.camera.set_parts(self.world.parts())
        self.camera.seed(setup.seed)

    def close(self) -> None:
        """Disconnect from PyBullet."""
        self.world.close()
