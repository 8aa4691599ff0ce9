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
from flowbothd.up_real import add_real_arguments, real_options
from flowbothd_bringup.robot_graph import NODES, given_parameters, missing_parameters
from flowbothd_common.environment import node_environment
from flowbothd_common.errors import FlowBotError
from flowbothd_common.parameter_files import Parameters
from flowbothd_common.parameters import build, specifications
from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import make_kinematics
from franka_suction_driver.params import MotionParams


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd doctor`."""
    add_real_arguments(parser)
    parser.add_argument(
        "--listen", type=float, default=4.0, help="seconds to listen (default: %(default)s)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Look, listen, print the list; 0 if nothing is red."""
    os.environ.update(node_environment(arguments.domain))
    parameters = given_parameters(real_options(arguments))
    arm = parameters["arm_node"]
    checks = check_host(arm["backend"], str(arm.get("panda.robot_ip", "")))
    checks.append(judge_calibration(parameters, missing_parameters(parameters)))
    checks += listen(arguments.domain, arguments.listen, parameters)
    sys.stdout.write(as_text(checks, colour=sys.stdout.isatty()) + "\n")
    return 1 if any(check.light is Light.RED for check in checks) else 0


def listen(domain: int, seconds: float, parameters: Parameters) -> list[Check]:
    """Judge what is heard on a ROS domain for some seconds."""
    ear = Ear(domain)
    try:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            ear.spin(0.05)
        return _judged(ear, parameters)
    finally:
        ear.close()


def _judged(ear: Ear, parameters: Parameters) -> list[Check]:
    heard = ear.heard
    camera = "start the camera's driver, with its topics remapped to depth/... (docs)"
    driver = "start `flowbothd up real`; is the robot reachable?"
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
