"""Parameters of the bridge node."""

from __future__ import annotations

from dataclasses import dataclass, field

from flowbothd_common.errors import ParameterError
from flowbothd_common.parameters import parameter
from sim_bridge.camera import Intrinsics
from sim_bridge.depth_noise import DepthNoise
from sim_bridge.world import ArmWorldParams

_ARM = ArmWorldParams()
_LENS = Intrinsics()
_NOISE = DepthNoise()


@dataclass(frozen=True)
class CameraParams:
    """The depth camera."""

    position: tuple[float, ...] = parameter(
        (0.55, -1.1, 0.65), "Position of the optical frame in base [m]", length=3
    )
    quaternion: tuple[float, ...] = parameter(
        (-0.825857, 0.0, 0.0, 0.563879),
        "Orientation of the optical frame in base, xyzw (z forward, x right, y down)",
        length=4,
    )
    frame: str = parameter("depth_camera_link", "Frame id of images and clouds")
    rate: float = parameter(5.0, "Images per simulated second [Hz]", minimum=0.1, maximum=60.0)
    width: int = parameter(_LENS.width, "Image width [pixels]", minimum=16, maximum=4096)
    height: int = parameter(_LENS.height, "Image height [pixels]", minimum=16, maximum=4096)
    fx: float = parameter(_LENS.fx, "Focal length [pixels]", minimum=1.0)
    fy: float = parameter(_LENS.fy, "Focal length [pixels]", minimum=1.0)
    cx: float = parameter(_LENS.cx, "Image centre [pixels]")
    cy: float = parameter(_LENS.cy, "Image centre [pixels]")
    near: float = parameter(_LENS.near, "Nearest measured depth [m]", minimum=0.01)
    far: float = parameter(_LENS.far, "Farthest measured depth [m]", minimum=0.1)
    noise: float = parameter(_NOISE.sigma, "Depth noise at distance 0 [m]", minimum=0.0)
    noise_per_m2: float = parameter(
        _NOISE.sigma_per_m2, "Depth noise gained with distance squared [1/m]", minimum=0.0
    )
    flying_fraction: float = parameter(
        _NOISE.flying_fraction,
        "Share of the pixels at depth edges that fly between both surfaces",
        minimum=0.0,
        maximum=1.0,
    )

    @property
    def intrinsics(self) -> Intrinsics:
        """The lens."""
        return Intrinsics(
            self.width, self.height, self.fx, self.fy, self.cx, self.cy, self.near, self.far
        )

    @property
    def depth_noise(self) -> DepthNoise:
        """The noise."""
        return DepthNoise(self.noise, self.noise_per_m2, self.flying_fraction)


@dataclass(frozen=True)
class BridgeParams:
    """Parameters of the bridge node."""

    object: str = parameter(
        "custom_door", "Registered object, PartNet-Mobility folder, or .urdf file"
    )
    mode: str = parameter(
        "", "Mode of an object with modes; empty = its own choice, or drawn from the seed"
    )
    target_joint: str = parameter("", "Joint or link to open; empty = the object's own choice")
    object_position: tuple[float, ...] = parameter(
        (), "Origin of the object in base [m]; empty = the object's default pose", element=float
    )
    object_yaw: float = parameter(0.0, "Turn of the object about z [rad]; with object_position")
    seed: int = parameter(0, "Draws mode, proportions and depth noise", minimum=0)
    base_frame: str = parameter("panda_link0", "Frame id of all messages in the base frame")
    joint_names: tuple[str, ...] = parameter(_ARM.joint_names, "The arm's joints, in order")
    start: tuple[float, ...] = parameter(_ARM.start, "Joint positions after a reset [rad]")
    flange: str = parameter(_ARM.flange, "Link below which everything belongs to the tool")
    tip: str = parameter(_ARM.tip, "Frame of the cup's lip, +z out of the cup")
    cup_link: str = parameter(_ARM.cup_link, "The cup's soft link")
    resting_links: tuple[str, ...] = parameter(
        _ARM.resting_links, "Links that stand on the table and may touch it"
    )
    joint_state_rate: float = parameter(
        120.0, "Joint states, wrenches and /clock per simulated second [Hz]", minimum=10.0
    )
    suction_rate: float = parameter(60.0, "Suction measurements per simulated second [Hz]")
    state_rate: float = parameter(10.0, "sim/state per simulated second [Hz]", minimum=0.1)
    heartbeat_timeout: float = parameter(
        0.1, "Silence of motion/heartbeat after which the arm holds [s, steady]", minimum=0.01
    )
    start_tolerance: float = parameter(
        _ARM.start_tolerance,
        "Largest distance of a trajectory's first point from the commanded state [rad]",
        minimum=0.0,
    )
    camera: CameraParams = field(default_factory=CameraParams)

    def __post_init__(self) -> None:
        """Check what concerns several values."""
        if len(self.object_position) not in (0, 3):
            raise ParameterError(
                "parameter object_position has the wrong length",
                got=len(self.object_position),
                allowed="3 values, or none for the default pose",
            )
        if len(self.start) != len(self.joint_names):
            raise ParameterError(
                "parameters start and joint_names differ in length",
                got=(len(self.start), len(self.joint_names)),
            )

    @property
    def arm(self) -> ArmWorldParams:
        """Parameters of the world."""
        return ArmWorldParams(
            joint_names=self.joint_names,
            start=self.start,
            flange=self.flange,
            tip=self.tip,
            cup_link=self.cup_link,
            resting_links=self.resting_links,
            start_tolerance=self.start_tolerance,
        )
