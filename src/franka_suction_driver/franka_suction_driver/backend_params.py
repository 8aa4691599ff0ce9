"""Parameters of arm_node and pump_node, which stand between the topics and the hardware."""

from __future__ import annotations

from dataclasses import dataclass, field

from flowbothd_common.parameters import parameter
from franka_suction_driver.arm.params import RobotParams

BACKENDS = ("topic", "panda", "mock")


@dataclass(frozen=True)
class PandaParams:
    """Panda (FER) through panda-python; thresholds are libfranka's."""

    robot_ip: str = parameter("", "Address of the robot's control unit; needed by backend panda")
    command_rate: float = parameter(
        500.0, "How often the 1 kHz controller gets a target [Hz]", minimum=100.0, maximum=1000.0
    )
    stiffness: tuple[float, ...] = parameter(
        (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0),
        "Joint stiffness of the controller [Nm/rad]",
        minimum=0.0,
    )
    damping: tuple[float, ...] = parameter(
        (50.0, 50.0, 50.0, 20.0, 20.0, 20.0, 10.0),
        "Joint damping of the controller [Nms/rad]",
        minimum=0.0,
    )
    force_limit: float = parameter(
        45.0, "Our own force limit: brakes and latches before libfranka's reflex [N]", minimum=1.0
    )
    collision_force: float = parameter(
        70.0,
        "libfranka's upper force threshold: above it the robot's reflex stops it [N]",
        minimum=10.0,
        maximum=100.0,
    )
    collision_torques: tuple[float, ...] = parameter(
        (50.0, 50.0, 50.0, 50.0, 12.0, 12.0, 12.0),
        "libfranka's upper joint torque thresholds [Nm]",
        minimum=1.0,
        maximum=100.0,
    )
    lag_limit: float = parameter(
        0.15, "Distance of a joint from its target that counts as a fault [rad]", minimum=0.01
    )
    least_conditioning: float = parameter(
        0.03,
        "Smallest singular value of the tool's Jacobian at which the wrench is believed: libfranka "
        "reports zeros near a singularity [m/rad]",
        minimum=0.0,
    )
    recovery_timeout: float = parameter(
        5.0, "How long an error recovery that was asked for may take [s]", minimum=0.1
    )


@dataclass(frozen=True)
class ArmNodeParams:
    """Parameters of arm_node."""

    robot: RobotParams = field(default_factory=RobotParams)
    panda: PandaParams = field(default_factory=PandaParams)
    backend: str = parameter(
        "panda",
        "topic: a JointTrajectoryController; panda: libfranka; mock: no hardware, the panda "
        "backend runs against a simulated robot without dynamics",
        choices=BACKENDS,
    )
    rate: float = parameter(
        200.0, "Publishing rate of joint states and wrench [Hz]", minimum=30.0, maximum=1000.0
    )
    heartbeat_timeout: float = parameter(
        0.1, "Silence of motion/heartbeat after which the arm holds [s]", minimum=0.05, maximum=1.0
    )
    reconnect_period: float = parameter(
        5.0, "Pause between two attempts to reach the robot [s]", minimum=0.5
    )
    start_tolerance: float = parameter(
        0.03,
        "How far beside where the arm is commanded to be a trajectory may begin; one that begins "
        "elsewhere is refused, and the arm brakes [rad]",
        minimum=0.0,
    )
    reject_lag: float = parameter(
        0.1,
        "Backend topic: distance between command and joint state that tells that the controller "
        "has rejected a trajectory [rad]",
        minimum=0.01,
    )


@dataclass(frozen=True)
class PumpNodeParams:
    """Parameters of pump_node; the Cobot Pump through libfranka's VacuumGripper."""

    backend: str = parameter(
        "panda", "panda: libfranka; mock: no hardware", choices=("panda", "mock")
    )
    robot_ip: str = parameter("", "Address of the robot's control unit: the pump has the same")
    poll_rate: float = parameter(
        20.0, "How often the pump's state is read [Hz]", minimum=2.0, maximum=100.0
    )
    vacuum_timeout: float = parameter(
        3.0, "How long one build-up of vacuum may block the pump's command thread [s]", minimum=0.1
    )
    drop_off_timeout: float = parameter(
        2.0, "How long a release may block the pump's command thread [s]", minimum=0.1
    )
    profile: int = parameter(
        0, "Production set-up profile stored in the pump", minimum=0, maximum=3
    )
    part_present_vacuum: float = parameter(
        55000.0,
        "H2 of the profile: vacuum above which the pump says that a part is present; a set-point "
        "below it could never hold one [Pa]",
        minimum=1000.0,
    )
    released_vacuum: float = parameter(
        5000.0, "Vacuum below which a release counts as done [Pa]", minimum=100.0
    )
    command_timeout: float = parameter(
        2.0,
        "Silence of suction/command after which the part is released and the pump switched off [s]",
        minimum=0.6,
    )
