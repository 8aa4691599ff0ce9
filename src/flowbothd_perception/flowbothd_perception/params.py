"""Parameters of perception: the pipeline's, and those of the node around it."""

from __future__ import annotations

from dataclasses import dataclass, field

from flowbothd_common.errors import ParameterError
from flowbothd_common.parameters import parameter
from flowbothd_common.transforms import rotation_from_quaternion, transform
from flowbothd_common.types import Array


@dataclass(frozen=True)
class CropParams:
    """The workspace, in the base frame."""

    min_corner: tuple[float, ...] = parameter(
        (0.0, -0.65, 0.02),
        "lower corner of the workspace in base [m]; its z cuts off the table",
        length=3,
    )
    max_corner: tuple[float, ...] = parameter(
        (1.3, 0.65, 1.1), "upper corner of the workspace in base [m]", length=3
    )

    def __post_init__(self) -> None:
        """Refuse an empty box."""
        if any(low >= high for low, high in zip(self.min_corner, self.max_corner, strict=True)):
            raise ParameterError(
                "the workspace is empty",
                got=f"{self.min_corner} .. {self.max_corner}",
                allowed="crop.min_corner below crop.max_corner in x, y and z",
            )


@dataclass(frozen=True)
class RobotFilterParams:
    """Separation of points on the robot from points on the object."""

    padding: float = parameter(
        0.02, "distance from a link within which points are the robot's [m]", minimum=0.0
    )
    padded_links: tuple[str, ...] = parameter(
        ("suction_body", "suction_stem", "suction_cup"),
        "links with a padding of their own, as in robot.paddings",
        element=str,
    )
    paddings: tuple[float, ...] = parameter(
        (0.012, 0.008, 0.004),
        "padding of each of robot.padded_links [m]; small at the cup, where the held part begins",
        minimum=0.0,
        element=float,
    )
    scale: float = parameter(
        1.0, "size of every link's shapes about their middles, before padding", minimum=0.1
    )
    scales: tuple[float, ...] = parameter(
        (), "scale of each of robot.padded_links; empty = robot.scale", minimum=0.1, element=float
    )
    ignored_links: tuple[str, ...] = parameter((), "links whose points are kept", element=str)
    shadow: bool = parameter(
        False, "also remove points that the robot hides from the camera: edges seen as veils"
    )
    shadow_padding: float = parameter(
        0.0, "padding of what casts shadows [m]; a link's own padding if that is less", minimum=0.0
    )

    def __post_init__(self) -> None:
        """Check that names and paddings belong together."""
        if len(self.padded_links) != len(self.paddings):
            raise ParameterError(
                "robot.padded_links and robot.paddings differ in length",
                got=(len(self.padded_links), len(self.paddings)),
            )
        if self.scales and len(self.scales) != len(self.padded_links):
            raise ParameterError(
                "robot.padded_links and robot.scales differ in length",
                got=(len(self.padded_links), len(self.scales)),
            )


@dataclass(frozen=True)
class OutlierParams:
    """Removal of flying pixels and of what the robot filter leaves along the arm's outline."""

    candidates: int = parameter(
        1800,
        "points off the robot that are judged by their distances, drawn at random; "
        "never less than sampling.points",
        minimum=1,
    )
    min_depth_neighbors: int = parameter(
        8,
        "of the 24 pixels around a pixel, how many must be as far away, unless it lies on a slope; "
        "0 = not asked",
        minimum=0,
        maximum=24,
    )
    tolerance: float = parameter(
        0.006, "difference of depths that still counts as equally far [m]", minimum=0.0
    )
    steepness: float = parameter(
        2.0,
        "slope (tangent of the angle to the view) whose step from pixel to pixel still counts as "
        "equally far, where that is more than the tolerance",
        minimum=0.0,
    )
    nb_neighbors: int = parameter(
        12, "neighbours whose mean distance is judged; 0 = no outlier removal", minimum=0
    )
    std_ratio: float = parameter(
        3.0,
        "points whose mean neighbour distance exceeds the average by this many standard deviations "
        "are removed",
        minimum=0.0,
    )
    cluster_tolerance: float = parameter(
        0.03,
        "points are one cluster while gaps are smaller than this [m]; 0 = keep all clusters",
        minimum=0.0,
    )
    cluster_share: float = parameter(
        0.02,
        "clusters with less than this share of all points are removed",
        minimum=0.0,
        maximum=1.0,
    )


@dataclass(frozen=True)
class SamplingParams:
    """The object cloud's size."""

    points: int = parameter(1200, "points of the object cloud", minimum=1)


@dataclass(frozen=True)
class PipelineParams:
    """From points in the camera frame to the object cloud."""

    crop: CropParams = field(default_factory=CropParams)
    robot: RobotFilterParams = field(default_factory=RobotFilterParams)
    outliers: OutlierParams = field(default_factory=OutlierParams)
    sampling: SamplingParams = field(default_factory=SamplingParams)


@dataclass(frozen=True)
class CameraParams:
    """Pose and topics of the camera; the pose is calibrated, never guessed."""

    position: tuple[float, ...] = parameter(
        (), "position of the optical frame in base [m], 3 values; required", element=float
    )
    quaternion: tuple[float, ...] = parameter(
        (),
        "orientation of the optical frame in base, xyzw (z forward, x right, y down); required",
        element=float,
    )
    frame: str = parameter(
        "", "frame id that images must carry; empty = any, all taken as the optical frame"
    )
    depth_topic: str = parameter("depth/image_raw", "depth images, 16UC1 or 32FC1")
    info_topic: str = parameter("depth/camera_info", "intrinsics of the depth images")
    cloud_topic: str = parameter("points2", "clouds, organised or loose, of any layout")
    best_effort: bool = parameter(
        False, "subscribe as best effort: for drivers that publish their images so"
    )

    @property
    def T_base_camera(self) -> Array:
        """(4, 4) pose of the optical frame.

        Raises:
            ParameterError: position or orientation is missing or malformed.
        """
        if len(self.position) != 3 or len(self.quaternion) != 4 or not any(self.quaternion):
            raise ParameterError(
                "the camera's pose is not calibrated",
                got=f"camera.position {self.position}, camera.quaternion {self.quaternion}",
                allowed="3 numbers [m] and a quaternion xyzw",
                hint="give both as parameters of perception_node; they are never guessed",
            )
        return transform(rotation_from_quaternion(self.quaternion), self.position)


@dataclass(frozen=True)
class PerceptionNodeParams(PipelineParams):
    """The pipeline's parameters and the node's."""

    seed: int = parameter(0, "run seed of the sampling", minimum=0, maximum=2**62)
    base_frame: str = parameter("panda_link0", "frame of the object cloud")
    input: str = parameter(
        "depth",
        "depth: camera.depth_topic with camera.info_topic; cloud: camera.cloud_topic",
        choices=("depth", "cloud"),
    )
    max_depth: float = parameter(3.0, "farther measurements are dropped [m]", minimum=0.1)
    max_gap: float = parameter(
        0.1, "longest gap between joint states to interpolate over [s]", minimum=0.001
    )
    stationary_threshold: float = parameter(
        0.01,
        "longer gaps are bridged where no joint moved by more than this [rad]",
        minimum=0.0,
    )
    max_extrapolation: float = parameter(
        0.02, "how far joint positions are extrapolated to the time of an image [s]", minimum=0.0
    )
    joint_wait: float = parameter(
        0.5,
        "how long an image waits for the joint states of its time, steady clock [s]",
        minimum=0.0,
    )
    joint_timeout: float = parameter(
        0.7, "silence of joint_states after which they are missing, steady clock [s]", minimum=0.05
    )
    image_timeout: float = parameter(
        1.5, "silence of the camera after which it is missing, steady clock [s]", minimum=0.05
    )
    camera: CameraParams = field(default_factory=CameraParams)
