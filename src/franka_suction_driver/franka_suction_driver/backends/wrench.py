"""From libfranka's external wrench to ours: sign, point of reference, singularities, bias."""

from __future__ import annotations

import numpy as np

from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import Kinematics, conditioning


class ExternalWrench:
    """Turns O_F_ext_hat_K into what the environment exerts on the tool.

    libfranka counts forces by the robot on the environment positive; it reports all zeros in and
    near a singularity; and its torque is about frame K, which Desk places.

    Args:
        kinematics: The arm with our tip.
        least_conditioning: Smallest singular value of the tool's Jacobian at which it is believed.
    """

    def __init__(self, kinematics: Kinematics, least_conditioning: float) -> None:
        self._kinematics = kinematics
        self._least = least_conditioning
        self._bias: Array = np.zeros(6)

    def convert(self, raw: Array, q: Array, p_stiffness: Array) -> Array | None:
        """(6,) force and torque on the tool at our tip, in base axes; None = not known.

        Args:
            raw: (6,) O_F_ext_hat_K.
            q: (J,) joint positions.
            p_stiffness: (3,) origin of frame K in base [m].
        """
        measured = self._unbiased(raw, q, p_stiffness)
        return None if measured is None else measured - self._bias

    def tare(self, raw: Array, q: Array, p_stiffness: Array) -> bool:
        """Take this measurement for zero from now on; whether it was one."""
        measured = self._unbiased(raw, q, p_stiffness)
        if measured is None:
            return False
        self._bias = measured
        return True

    def _unbiased(self, raw: Array, q: Array, p_stiffness: Array) -> Array | None:
        tip = self._kinematics.tip(q)
        # Written so that what is not finite fails.
        known = np.isfinite(raw).all() and np.any(raw) and float(conditioning(tip)) >= self._least
        if not known:
            return None
        force, torque = -raw[:3], -raw[3:]
        moved = torque + np.cross(p_stiffness - tip.position, force)
        return np.concatenate([force, moved])
