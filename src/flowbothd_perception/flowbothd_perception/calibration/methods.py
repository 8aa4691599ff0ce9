"""The three things that can be done with captures: calibrate by tool, by board, and check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio

from flowbothd_common.errors import InvalidCloudError, ParameterError
from flowbothd_common.motion import joint_order
from flowbothd_common.transforms import apply, inverse
from flowbothd_common.types import Array
from flowbothd_perception.calibration.board import Board, find_board
from flowbothd_perception.calibration.captures import Capture
from flowbothd_perception.calibration.hand_eye import solve_hand_eye
from flowbothd_perception.calibration.pose import Calibration, difference
from flowbothd_perception.calibration.tool_fit import fit_robot
from flowbothd_perception.params import RobotFilterParams
from flowbothd_perception.robot_filter import RobotFilter

FINE, POOR = 0.005, 0.01
"""How far off the tool may look [m]: up to the first it is fine, beyond the second it is bad."""


@dataclass(frozen=True)
class Check:
    """Estimated error of a calibration.

    Attributes:
        at_tool: Mean distance between where the tool is seen and where it is [m].
        camera: How far the camera would have to be moved [m].
        angle: How far it would have to be turned [rad].
        better: The calibration that explains the captures best.
    """

    at_tool: float
    camera: float
    angle: float
    better: Calibration

    @property
    def verdict(self) -> str:
        """For people."""
        if self.at_tool <= FINE:
            return "fine: the body filter's paddings cover this"
        if self.at_tool <= POOR:
            return "poor: points of the tool may remain; calibrate again when you can"
        return "bad: do not run with it; calibrate again"


def by_tool(
    urdf: str, tool_links: Sequence[str], captures: Sequence[Capture], guess: Array, seed: int = 0
) -> Calibration:
    """Camera pose from the arm's own shape; see `fit_robot`.

    Raises:
        ObjectModelError, ParameterError: the robot description, or a link that it does not have.
        InvalidCloudError: too few captures, or the robot is not seen in them.
    """
    return fit_robot(_bare(urdf, tool_links), tool_links, captures, guess, seed=seed)


def by_board(
    urdf: str, tip_frame: str, captures: Sequence[Capture], board: Board
) -> tuple[Calibration, Array]:
    """Camera pose, and T_tip_board, from a board that the tool carries.

    Raises:
        ParameterError: the robot has no such frame.
        InvalidCloudError: too few captures in which the board is found.
    """
    tips, seen = [], []
    for capture in captures:
        if capture.picture is None:
            continue
        corners = find_board(capture.picture, capture.lens, board)
        if corners is not None:
            tips.append(_tip(urdf, tip_frame, capture))
            seen.append(corners)
    if len(seen) < 3:
        raise InvalidCloudError(
            "the board is found in too few captures",
            got=f"{len(seen)} of {len(captures)}",
            allowed="at least 3, better 8 or more",
            hint="check the numbers of inner corners, the light, and that pictures were recorded",
        )
    return solve_hand_eye(tips, seen, board.corners)


def check(
    urdf: str, tool_links: Sequence[str], captures: Sequence[Capture], told: Array, seed: int = 0
) -> Check:
    """Estimate the error of a camera pose: moving points are compared with the robot's shape.

    Raises:
        As `by_tool`.
    """
    better = by_tool(urdf, tool_links, captures, told, seed)
    shift = told @ inverse(better.T_base_camera)
    tool = np.stack([_tip(urdf, tool_links[0], capture)[:3, 3] for capture in captures])
    distance, angle = difference(better.T_base_camera, told)
    at_tool = float(np.linalg.norm(apply(shift, tool) - tool, axis=1).mean())
    return Check(at_tool, distance, angle, better)


def _bare(urdf: str, tool_links: Sequence[str]) -> RobotFilter:
    robot = RobotFilter(urdf, RobotFilterParams(padding=0.0, padded_links=(), paddings=()))
    unknown = sorted(set(tool_links) - set(robot.links))
    if unknown or not tool_links:
        raise ParameterError(
            "tool links without a shape",
            got=unknown or "none",
            allowed=", ".join(dict.fromkeys(robot.links)),
        )
    return robot


def _tip(urdf: str, frame: str, capture: Capture) -> Array:
    """(4, 4) T_base_frame of a capture."""
    model = pinocchio.buildModelFromXML(urdf)
    if not model.existFrame(frame):
        raise ParameterError(
            "the robot has no such frame",
            got=frame,
            allowed=", ".join(f.name for f in model.frames),
        )
    order = joint_order(tuple(model.names[1:]), capture.joint_names)
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, capture.joint_positions[order])
    return np.asarray(data.oMf[model.getFrameId(frame)].homogeneous)
