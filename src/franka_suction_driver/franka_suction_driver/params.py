"""Parameters of the motion node and the suction node; the cores take them as they are."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi

from flowbothd_common.parameters import parameter

_FER = (3.75, 1.875, 2.5, 3.125, 3.75, 5.0, 5.0)


@dataclass(frozen=True)
class RobotParams:
    """Names, limits and start pose of the arm."""

    joint_names: tuple[str, ...] = parameter(
        tuple(f"panda_joint{i}" for i in range(1, 8)), "Arm joints, base to tip"
    )
    base_frame: str = parameter("panda_link0", "Frame of all goals and poses")
    tip_frame: str = parameter("suction_tip", "Frame at the centre of the cup's lip")
    description_file: str = parameter(
        "", "URDF file to use instead of the composed description; empty = compose"
    )
    start_positions: tuple[float, ...] = parameter(
        (0.0, -pi / 4, 0.0, -3 * pi / 4, 0.0, pi / 2, pi / 4),
        "Joint positions that Retreat returns to [rad]",
    )
    lower_limits: tuple[float, ...] = parameter(
        (), "Lowest joint positions [rad]; empty = the description's", element=float
    )
    upper_limits: tuple[float, ...] = parameter(
        (), "Highest joint positions [rad]; empty = the description's", element=float
    )
    velocity_limits: tuple[float, ...] = parameter(
        (), "Largest joint velocities [rad/s]; empty = the description's", element=float
    )
    acceleration_limits: tuple[float, ...] = parameter(
        _FER, "Largest joint accelerations [rad/s^2]", minimum=0.01
    )
    jerk_limits: tuple[float, ...] = parameter(
        (500.0,) * 7, "Largest joint jerks [rad/s^3]", minimum=1.0
    )
    position_margin: float = parameter(
        0.05, "Kept distance from the joint position limits [rad]", minimum=0.0, maximum=0.5
    )
    speed_scale: float = parameter(
        0.5,
        "Approach and Retreat: joint speed as a part of the limits, before safety.speed_scale",
        minimum=0.01,
        maximum=1.0,
    )


@dataclass(frozen=True)
class CollisionParams:
    """What the arm keeps away from, and how far."""

    table_height: float = parameter(0.0, "Top of the table in the base frame [m]")
    table_margin: float = parameter(0.015, "Kept distance from the table [m]", minimum=0.0)
    self_margin: float = parameter(0.005, "Kept distance between links [m]", minimum=0.0)
    obstacle_margin: float = parameter(
        0.01, "Kept distance from the observed object [m]", minimum=0.0
    )
    hidden_depth: float = parameter(
        0.07,
        "Thickness presumed behind what the camera sees, along its view: a door frame is deeper "
        "than its front tells. Less than the standoff, or nothing could be reached from behind [m]",
        minimum=0.0,
    )
    obstacle_cell: float = parameter(
        0.01, "Edge of the cells that the object cloud is turned into [m]", minimum=0.003
    )


@dataclass(frozen=True)
class PlanningParams:
    """Search for collision-free paths and for the right arm configuration."""

    ik_seeds: int = parameter(96, "Random starts of the inverse kinematics", minimum=8)
    max_iterations: int = parameter(
        3000, "Growing steps of the path search before it gives up", minimum=10
    )
    shortcuts: int = parameter(80, "Attempts to shorten a found path", minimum=0)
    resolution: float = parameter(
        0.04, "Joint distance between two collision checks [rad]", minimum=0.005, maximum=0.2
    )
    continuation: float = parameter(
        0.18, "Opening that should stay reachable beyond the contact [m]", minimum=0.0
    )
    tilt_slack: float = parameter(
        0.26, "Tilt of the tool against the flow accepted to reach further [rad]", minimum=0.0
    )
    least_push: float = parameter(
        0.4,
        "Part of the opening that must be reachable before the opposite side is taken",
        minimum=0.0,
        maximum=1.0,
    )
    pull: bool = parameter(
        True, "Come from the side of the flow where it can be reached; false = always push"
    )
    push_from_front: bool = parameter(
        True, "Come from the opposite side where the side of the flow cannot be reached"
    )


@dataclass(frozen=True)
class ApproachParams:
    """Approach and Retreat."""

    standoff: float = parameter(0.10, "Distance of the standoff from the contact [m]", minimum=0.01)
    back_off: float = parameter(
        0.10, "Retreat: distance straight back along the tool axis [m]", minimum=0.0
    )
    force_limit: float = parameter(25.0, "Contact force that stops a free motion [N]", minimum=1.0)


@dataclass(frozen=True)
class ProbeParams:
    """Probe: from the standoff until the cup holds."""

    increment: float = parameter(0.02, "Length of one increment [m]", minimum=0.001)
    max_distance: float = parameter(0.12, "Longest way [m]", minimum=0.001)
    speed: float = parameter(0.03, "Speed near the contact [m/s]", minimum=0.001)
    free_distance: float = parameter(0.06, "Way that is travelled faster [m]", minimum=0.0)
    free_speed: float = parameter(0.08, "Speed on that way [m/s]", minimum=0.001)
    contact_force: float = parameter(
        4.0, "Force against the travel that counts as contact [N]", minimum=0.1
    )
    force_limit: float = parameter(30.0, "Force that ends the motion [N]", minimum=1.0)
    vacuum_wait: float = parameter(
        0.8, "How long to wait for vacuum after contact [s]", minimum=0.0, maximum=10.0
    )


@dataclass(frozen=True)
class FlowStepParams:
    """FlowStep: one guarded step along the flow."""

    distance: float = parameter(0.05, "Length of a step [m]", minimum=0.001)
    speed: float = parameter(0.04, "Speed along the flow [m/s]", minimum=0.001)
    admittance: float = parameter(
        0.0025, "Sideways speed per sideways force [m/s/N]", minimum=0.0, maximum=0.05
    )
    max_offset: float = parameter(
        0.04, "Largest sideways deviation from the straight step [m]", minimum=0.0
    )
    realign_part: float = parameter(
        0.8, "Part of the step in which the tool turns to the flow", minimum=0.1, maximum=1.0
    )
    lead: float = parameter(
        0.5,
        "Turn ahead of the flow, as a part of the turn since the last step",
        minimum=0.0,
        maximum=1.0,
    )
    max_lead: float = parameter(0.2, "Largest turn ahead of the flow [rad]", minimum=0.0)
    push_lag: float = parameter(
        0.42,
        "Tilt at which a pushing tool begins to turn with the face; turning at once, its body "
        "swings into the frame that the part leaves. Below the tilt at which the cup peels [rad]",
        minimum=0.0,
        maximum=1.0,
    )
    force_limit: float = parameter(
        22.0,
        "Force on the tool that ends the step; below what breaks the cup loose [N]",
        minimum=1.0,
    )
    stall_distance: float = parameter(
        0.015,
        "Lag of the measured behind the commanded tool that counts as stalled [m]",
        minimum=0.001,
    )
    settle_time: float = parameter(0.25, "Longest wait for the force to relax [s]", minimum=0.0)
    relaxed_force: float = parameter(4.0, "Force that counts as relaxed [N]", minimum=0.1)


@dataclass(frozen=True)
class SafetyParams:
    """The envelope around all motion: what a stranger's robot is moved within.

    The simulation has its own, wider one (flowbothd_bringup, config/sim.yaml).
    """

    speed_scale: float = parameter(
        0.1, "Part of all speeds, of joints and of the tool", minimum=0.01, maximum=1.0
    )
    workspace_min: tuple[float, ...] = parameter(
        (-0.2, -0.8, 0.0), "Low corner of the box that the tip stays in, in base [m]", length=3
    )
    workspace_max: tuple[float, ...] = parameter(
        (1.0, 0.8, 1.1), "High corner of the box that the tip stays in, in base [m]", length=3
    )
    force_limit: float = parameter(
        40.0,
        "Force on the tool that stops any motion and latches the stop; to be below the robot's own "
        "reflex [N]",
        minimum=1.0,
    )
    lag_limit: float = parameter(
        0.15,
        "Distance of the arm from everything commanded in the last quarter second that tells that "
        "it does not follow [rad]",
        minimum=0.01,
    )
    slow_conditioning: float = parameter(
        0.08,
        "Smallest singular value of the tool's Jacobian below which the tool slows down, in "
        "proportion; 0 = never [m/rad]",
        minimum=0.0,
    )
    slow_margin: float = parameter(
        0.12,
        "Distance of a joint from its limit below which the tool slows down, in proportion; "
        "0 = never [rad]",
        minimum=0.0,
    )
    dry_run: bool = parameter(False, "Plan and show, but never move")
    audit_log: str = parameter(
        "", "File that every commanded motion is written to, one JSON object a line; empty = none"
    )
    audit_size: int = parameter(
        10_000_000, "Size at which the audit log is rotated, ten files are kept [B]", minimum=10_000
    )


@dataclass(frozen=True)
class MotionParams:
    """Parameters of the motion core."""

    robot: RobotParams = field(default_factory=RobotParams)
    collision: CollisionParams = field(default_factory=CollisionParams)
    planning: PlanningParams = field(default_factory=PlanningParams)
    approach: ApproachParams = field(default_factory=ApproachParams)
    probe: ProbeParams = field(default_factory=ProbeParams)
    flow_step: FlowStepParams = field(default_factory=FlowStepParams)
    safety: SafetyParams = field(default_factory=SafetyParams)
    seed: int = parameter(0, "Seed of all random choices in planning", minimum=0)


@dataclass(frozen=True)
class WrenchParams:
    """How the topic external_wrench is to be read."""

    sign: float = parameter(
        1.0,
        "1.0: the wrench is what the environment exerts on the tool, in base axes: pressing the "
        "cup upwards gives a positive z. -1.0: what the tool exerts, as franka_ros publishes it",
        minimum=-1.0,
        maximum=1.0,
    )
    frame: str = parameter(
        "", "Frame id that the wrench must carry, if any; its axes are the base's. Empty = base"
    )


@dataclass(frozen=True)
class MotionNodeParams(MotionParams):
    """Parameters of motion_node: the core's, and what concerns the node."""

    wrench: WrenchParams = field(default_factory=WrenchParams)
    rate: float = parameter(60.0, "Control rate [Hz]", minimum=20.0, maximum=200.0)
    watch_nodes: tuple[str, ...] = parameter(
        (), "Nodes whose silent heartbeat stops the arm", element=str
    )
    watch_timeout: float = parameter(
        0.7,
        "Silence of a watched node or of suction/state, on the steady clock, that stops the arm; "
        "they speak at 5 and 20 Hz [s]",
        minimum=0.05,
        maximum=10.0,
    )
    input_timeout: float = parameter(
        0.1,
        "Silence of joint_states or external_wrench, on the steady clock, that stops the arm [s]",
        minimum=0.02,
        maximum=10.0,
    )
    clock_timeout: float = parameter(
        0.2,
        "How long the node clock may stand still, on the steady clock, before the arm stops: with "
        "use_sim_time a /clock that is missing or has stopped [s]",
        minimum=0.02,
        maximum=10.0,
    )
    stamp_tolerance: float = parameter(
        0.5,
        "Largest difference of a stamp of joint_states or external_wrench from the node clock; "
        "farther ones count as not received [s]",
        minimum=0.01,
        maximum=60.0,
    )
    ready_nodes: tuple[str, ...] = parameter(
        (), "Those of watch_nodes that must also say that they are ready: the arm's", element=str
    )
    camera_position: tuple[float, ...] = parameter(
        (),
        "Where the depth camera stands in base [m], 3 values: room behind what it sees is kept out "
        "of (collision.hidden_depth); empty = only what is seen counts",
        element=float,
    )
    require_wrench: bool = parameter(
        True, "Refuse guarded motions while no external wrench arrives"
    )


@dataclass(frozen=True)
class SuctionParams:
    """Parameters of suction_node and its state machine."""

    max_vacuum: float = parameter(80000.0, "Largest vacuum that may be set [Pa]", minimum=1000.0)
    measurement_timeout: float = parameter(
        0.5, "Silence of the pump on the steady clock that counts as a fault [s]", minimum=0.05
    )
    release_pressure: float = parameter(
        5000.0, "Vacuum below which a part counts as released [Pa]", minimum=0.0
    )
    release_timeout: float = parameter(
        2.0, "How long a release may take before it is a fault [s]", minimum=0.1
    )
