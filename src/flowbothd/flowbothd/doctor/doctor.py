"""`flowbothd doctor`: a red and green list of all that keeps the first door from opening."""

from __future__ import annotations

import argparse
import os
import sys
import time

import numpy as np

from flowbothd.doctor.doctor_checks import (
    Check,
    Light,
    as_text,
    judge_calibration,
    judge_end_effector,
    judge_nodes,
    judge_pump,
    judge_rate,
    judge_stamps,
    judge_wrench,
)
from flowbothd.doctor.doctor_ear import Ear
from flowbothd.doctor.doctor_host import check_host
from flowbothd.doctor.doctor_touch import ASK, Felt, WrenchSample, feel, judge_touch, not_asked
from flowbothd.up_robot import add_robot_arguments, robot_options
from flowbothd_bringup.robot_graph import NODES, given_parameters, missing_parameters
from flowbothd_common.environment import node_environment
from flowbothd_common.errors import FlowBotError
from flowbothd_common.parameter_files import Parameters
from flowbothd_common.parameters import build, specifications
from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import make_kinematics
from franka_suction_driver.params import MotionParams

# How long a touch is waited for, and how often it is looked for [s].
_TOUCH = 15.0
_GLANCE = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd doctor`."""
    add_robot_arguments(parser)
    parser.add_argument(
        "--listen", type=float, default=4.0, help="seconds to listen (default: %(default)s)"
    )
    parser.add_argument(
        "--touch",
        action="store_true",
        help="ask for a light touch of the cup, and check sign and frame of the wrench by it",
    )


def run(arguments: argparse.Namespace) -> int:
    """Look, listen, print the list; 0 if nothing is red."""
    os.environ.update(node_environment(arguments.domain))
    parameters = given_parameters(robot_options(arguments))
    arm = parameters["arm_node"]
    checks = check_host(arm["backend"], str(arm.get("panda.robot_ip", "")))
    checks.append(judge_calibration(parameters, missing_parameters(parameters)))
    checks += listen(arguments.domain, arguments.listen, parameters, touch=arguments.touch)
    sys.stdout.write(as_text(checks, colour=sys.stdout.isatty()) + "\n")
    return 1 if any(check.light is Light.RED for check in checks) else 0


def listen(
    domain: int, seconds: float, parameters: Parameters, *, touch: bool = False
) -> list[Check]:
    """Judge what is heard on a ROS domain for some seconds, and during a touch if one is wanted."""
    ear = Ear(domain)
    try:
        _hear(ear, seconds)
        checks = _judged(ear, parameters)
        checks.append(ask_for_touch(ear, parameters) if touch else not_asked())
        return checks
    finally:
        ear.close()


def ask_for_touch(ear: Ear, parameters: Parameters, seconds: float = _TOUCH) -> Check:
    """Ask the operator to press the cup, and judge what the wrench says meanwhile.

    Args:
        ear: Has heard the wrench at rest.
        parameters: Of the graph: base frame and sign of the wrench.
        seconds: How long the touch is waited for at most.
    """
    motion = parameters["motion_node"]
    rest: list[WrenchSample] = list(ear.wrenches)
    sys.stdout.write(f"{ASK[0].upper()}{ASK[1:]} (within {seconds:g} s).\n")
    sys.stdout.flush()
    deadline = time.monotonic() + seconds
    felt = feel(rest, [])
    while time.monotonic() < deadline:
        _hear(ear, min(_GLANCE, seconds))
        felt = feel(rest, ear.wrenches[len(rest) :])
        if felt.felt in (Felt.UP, Felt.DOWN):
            # The touch may not be over: its other half would make it unclear.
            _hear(ear, _GLANCE)
            felt = feel(rest, ear.wrenches[len(rest) :])
            break
    base = str(motion.get("robot.base_frame", MotionParams().robot.base_frame))
    return judge_touch(felt, base, float(motion.get("wrench.sign", 1.0)))


def _hear(ear: Ear, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        ear.spin(0.05)


def _judged(ear: Ear, parameters: Parameters) -> list[Check]:
    heard = ear.heard
    camera = "start the camera's driver, with its topics remapped to depth/... (docs)"
    driver = "start `flowbothd up robot`; is the robot reachable?"
    return [
        judge_rate("camera, depth/image_raw", heard["depth/image_raw"], 4.0, camera),
        judge_rate("camera, depth/camera_info", heard["depth/camera_info"], 4.0, camera),
        judge_stamps("camera stamps", heard["depth/image_raw"]),
        judge_rate("joint_states", heard["joint_states"], 50.0, driver),
        judge_stamps("joint state stamps", heard["joint_states"]),
        judge_end_effector(_our_tip(ear.positions, parameters), ear.end_effector),
        judge_wrench("external_wrench", ear.forces),
        judge_pump(heard["suction/measurement"], ear.pump_fault),
        *judge_nodes(list(NODES), ear.said),
    ]


def _our_tip(positions: dict[str, float], parameters: Parameters) -> Array | None:
    names = {spec.name for spec in specifications(MotionParams)}
    given = {n: v for n, v in parameters["motion_node"].items() if n in names}
    params = build(MotionParams, given)
    if any(name not in positions for name in params.robot.joint_names):
        return None
    try:
        kinematics = make_kinematics(params)
    except FlowBotError:
        return None
    q = np.array([positions[name] for name in params.robot.joint_names])
    return kinematics.tip(q).position
