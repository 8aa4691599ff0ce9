"""`flowbothd calibrate`: where the camera is, and whether it is still there."""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

import numpy as np

from flowbothd_common.errors import FlowBotError, ParameterError
from flowbothd_common.parameter_files import Parameters, read_parameters, write_parameters
from flowbothd_common.parameters import build
from flowbothd_common.transforms import look_at
from flowbothd_common.types import Array
from flowbothd_perception.calibration import captures as files
from flowbothd_perception.calibration.board import Board
from flowbothd_perception.calibration.captures import Capture
from flowbothd_perception.calibration.methods import by_board, by_tool, check
from flowbothd_perception.calibration.pose import Calibration
from flowbothd_perception.params import CameraParams, PerceptionNodeParams
from franka_suction_driver.arm.description import compose_urdf, read_description

_NODE = "perception_node"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd calibrate`."""
    parser.add_argument(
        "method",
        choices=("tool", "board", "check"),
        help="tool: from the arm's own shape; board: from a printed chessboard on the tool; "
        "check: how far off the present calibration looks",
    )
    parser.add_argument(
        "--captures", type=Path, required=True, help="folder of captures to read, or to record into"
    )
    parser.add_argument(
        "--record",
        type=int,
        default=0,
        metavar="N",
        help="first take N captures from the running camera and robot: move the arm by hand, and "
        "let it rest a second in every pose",
    )
    parser.add_argument("--timeout", type=float, default=600.0, help="of the recording [s]")
    parser.add_argument("--domain", type=int, default=None, help="ROS domain (default: as set)")
    parser.add_argument(
        "--parameters", type=Path, help="YAML with perception_node's camera: topics, pose so far"
    )
    parser.add_argument(
        "--guess",
        type=float,
        nargs=6,
        metavar=("X", "Y", "Z", "TX", "TY", "TZ"),
        help="tool: where the camera is and a point that it looks at, by tape measure [m, base]",
    )
    parser.add_argument("--urdf", default="", help="robot description (default: arm and our tool)")
    parser.add_argument(
        "--tool-links", nargs="+", default=["suction_body", "suction_stem", "suction_cup"]
    )
    parser.add_argument("--tip", default="suction_tip", help="board: frame that carries it")
    parser.add_argument(
        "--board", default="9x6", help="board: inner corners (default: %(default)s)"
    )
    parser.add_argument("--square", type=float, help="board: side of a square, measured [m]")
    parser.add_argument("--picture", default="ir/image_raw", help="board: topic of its pictures")
    parser.add_argument("--out", type=Path, help="parameter file to write")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate or check; status 1 if a check finds the calibration bad."""
    given = read_parameters(arguments.parameters) if arguments.parameters else {}
    camera = _camera(given)
    if arguments.record:
        _record(arguments, camera)
    captures = files.load(arguments.captures)
    urdf = read_description(arguments.urdf) or compose_urdf()
    if arguments.method == "check":
        result = check(urdf, arguments.tool_links, captures, camera.T_base_camera)
        sys.stdout.write(
            f"the tool is seen {1e3 * result.at_tool:.1f} mm from where it is; the camera looks "
            f"{1e3 * result.camera:.1f} mm and {np.degrees(result.angle):.2f} degrees off\n"
            f"{result.verdict}\n"
        )
        return 1 if result.verdict.startswith("bad") else 0
    if arguments.method == "tool":
        guess = _guess(arguments.guess, camera)
        calibration = by_tool(urdf, arguments.tool_links, captures, guess)
    else:
        calibration, _ = by_board(urdf, arguments.tip, captures, _board(arguments))
    sys.stdout.write(summary(calibration) + "\n")
    if arguments.out:
        _write(arguments.out, given, calibration)
        sys.stdout.write(f"written to {arguments.out}\n")
    return 0


def summary(calibration: Calibration) -> str:
    """The result for people."""
    position, quaternion = calibration.parameters.values()
    return (
        f"camera.position {position}\ncamera.quaternion {quaternion} (xyzw)\n"
        f"residual {1e3 * calibration.residual:.2f} mm, worst pose {1e3 * calibration.worst:.2f} "
        f"mm, from {calibration.points} points of {calibration.poses} arm poses\n"
        f"without any one of the poses the camera moves by at most "
        f"{1e3 * calibration.spread:.2f} mm and {np.degrees(calibration.spread_angle):.3f} degrees"
    )


def _camera(given: Parameters) -> CameraParams:
    params = build(PerceptionNodeParams, given.get(_NODE, {}))
    return params.camera


def _guess(numbers: list[float] | None, camera: CameraParams) -> Array:
    if numbers is None:
        if not camera.position:
            raise ParameterError(
                "calibrating from the tool needs a first guess",
                allowed="--guess X Y Z TX TY TZ, or --parameters with the pose so far",
                hint="a tape measure will do: 10 cm and 10 degrees are near enough",
            )
        return camera.T_base_camera
    try:
        return look_at(numbers[:3], numbers[3:])
    except ValueError as error:
        raise ParameterError("--guess describes no view", got=numbers, hint=str(error)) from error


def _board(arguments: argparse.Namespace) -> Board:
    columns, _, rows = str(arguments.board).partition("x")
    if not (columns.isdigit() and rows.isdigit()):
        raise ParameterError("--board", got=arguments.board, allowed="inner corners, such as 9x6")
    if arguments.square is None:
        raise ParameterError(
            "--square is missing", hint="measure a square of the print: printers scale"
        )
    return Board(int(columns), int(rows), arguments.square)


def _write(path: Path, given: Parameters, calibration: Calibration) -> None:
    """The parameters given, with the new pose."""
    values = {**given.get(_NODE, {}), **calibration.parameters}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_parameters(path, {**given, _NODE: values})


def _record(arguments: argparse.Namespace, camera: CameraParams) -> None:
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor

    from flowbothd_perception.calibration.recorder_ros import CaptureNode

    taken: list[Capture] = []

    def keep(capture: Capture) -> None:
        taken.append(capture)
        files.save(arguments.captures, taken)
        sys.stdout.write(f"capture {len(taken)} of {arguments.record}; move the arm on\n")
        sys.stdout.flush()

    domain = arguments.domain
    context = Context()
    rclpy.init(
        context=context,
        domain_id=int(os.environ.get("ROS_DOMAIN_ID", "0")) if domain is None else domain,
    )
    executor = SingleThreadedExecutor(context=context)
    picture = arguments.picture if arguments.method == "board" else ""
    node = CaptureNode(camera, picture, keep, context=context)
    executor.add_node(node)
    try:
        end = time.monotonic() + arguments.timeout
        while len(taken) < arguments.record:
            if time.monotonic() > end:
                heard = ", ".join(sorted(node.heard)) or "nothing"
                raise FlowBotError(
                    "the captures were not completed in time",
                    got=f"{len(taken)} of {arguments.record}; heard {heard}",
                    hint="let the arm rest a second in every pose; check topics and ROS domain",
                )
            executor.spin_once(timeout_sec=0.2)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)
