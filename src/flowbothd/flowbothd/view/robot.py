"""Poses of the links of a described robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio

from flowbothd_common.types import Array


class RobotPoses:
    """Forward kinematics of a URDF for whatever joints are known.

    Args:
        urdf: Text of the description.
        tip: Frame of the tool's tip.
    """

    def __init__(self, urdf: str, tip: str = "suction_tip") -> None:
        self._model = pinocchio.buildModelFromXML(urdf)
        self._data = self._model.createData()
        self._q = pinocchio.neutral(self._model)
        self._tip = tip
        self._joints = {
            name: int(self._model.joints[self._model.getJointId(name)].idx_q)
            for name in self._model.names[1:]
        }

    def move(self, names: Sequence[str], positions: Sequence[float]) -> None:
        """Take in joint positions [rad]; unknown joints are ignored."""
        for name, position in zip(names, positions, strict=False):
            if name in self._joints:
                self._q[self._joints[name]] = position
        pinocchio.framesForwardKinematics(self._model, self._data, self._q)

    def pose(self, frame: str) -> Array:
        """(4, 4) T_base_frame at the last positions."""
        matrix: Array = self._data.oMf[self._model.getFrameId(frame)].homogeneous
        return np.array(matrix)

    def tip(self) -> Array | None:
        """(3,) where the tip of the tool is in base [m]; None if the robot has none."""
        if not self._model.existFrame(self._tip):
            return None
        return self.pose(self._tip)[:3, 3]
