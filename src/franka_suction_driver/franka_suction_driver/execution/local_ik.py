"""Inverse kinematics of one tool pose next to a configuration, fast enough to be done while moving.

The arithmetic of `inverse_kinematics.limited_step`, in the tip's own axes and without batches:
there Pinocchio's Jacobian needs no turning, and a step takes some forty microseconds.
"""

from __future__ import annotations

from math import atan2, hypot, pi

import numpy as np
import pinocchio
from scipy.linalg.lapack import dposv

from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import PositionBox
from franka_suction_driver.planning.inverse_kinematics import (
    FOLLOW_DAMPING,
    SOFT_ZONE,
    joint_weights,
)

_TOLERANCE = 5e-4
"""Position error of a pose that counts as reached [m]."""
_MOST_STEPS = 12
"""Newton steps at most: the budget of one control tick."""
_EXACT_STEPS = 3
"""Newton steps before the tilt may give way: next to the pose before, three are enough."""
_GIVING_WAY = np.array([1.0, 1.0, 1.0, 0.05, 0.05])
"""Weights of the task error (3 position, 2 tilt) while the tilt gives way [-]: position comes
first."""
_DAMPING = FOLLOW_DAMPING**2 * np.eye(5)
"""Damping of the normal equations [-], as in `inverse_kinematics.limited_step`."""


class LocalIk:
    """Finds configurations next to given ones.

    Args:
        kinematics: The arm.
        box: Position limits, never left.
        tilt_slack: Tilt that is accepted in order to stay in reach [rad].
    """

    def __init__(self, kinematics: Kinematics, box: PositionBox, tilt_slack: float) -> None:
        self._model = kinematics.model
        self._data = self._model.createData()
        self._tip = self._model.getFrameId(kinematics.tip_frame)
        self._base = self._model.frames[self._model.getFrameId(kinematics.base_frame)].placement
        self._box = box
        self._slack = max(tilt_slack, 1e-3)

    def reach(self, q: Array, position: Array, axis: Array) -> Array | None:
        """(J,) next to `q` at the tool pose, tilted as little as needed, or None.

        Args:
            q: (J,) inside the box.
            position: (3,) wanted tip position in base [m].
            axis: (3,) wanted unit direction of the tool's z axis in base.
        """
        position = self._base.rotation @ position + self._base.translation
        axis = self._base.rotation @ axis
        for attempt in range(_MOST_STEPS):
            jacobian, miss = self._look(q, position, axis)
            size = float(np.sqrt(miss @ miss))
            if size < 1e-7 or (0 < attempt < _EXACT_STEPS and size < 1e-5):
                return q
            if attempt >= _EXACT_STEPS:
                # Out of reach as asked: hold the position and let the tilt give way.
                if float(miss[:3] @ miss[:3]) < (_TOLERANCE / 5) ** 2:
                    break
                miss, jacobian = miss * _GIVING_WAY, jacobian * _GIVING_WAY[:, None]
            q = q + self._step(q, jacobian, miss)
            q = np.minimum(np.maximum(q, self._box.lower), self._box.upper)
        _, miss = self._look(q, position, axis)
        near = float(miss[:3] @ miss[:3]) < _TOLERANCE**2
        return q if near and hypot(miss[3], miss[4]) < self._slack else None

    def tips(self, path: Array) -> Array:
        """(K, 3) tip positions in base [m] of configurations (K, J)."""
        found = np.empty((len(path), 3))
        for k, q in enumerate(path):
            pinocchio.forwardKinematics(self._model, self._data, q)
            placement = pinocchio.updateFramePlacement(self._model, self._data, self._tip)
            found[k] = placement.translation
        return np.asarray((found - self._base.translation) @ self._base.rotation)

    def ahead(self, before: Array, q: Array) -> Array:
        """(J,) where to look for what follows `q`: on by the last step, if limits are far."""
        guess = 2.0 * q - before
        return guess if self._box.margin(guess) > SOFT_ZONE else q

    def _look(self, q: Array, position: Array, axis: Array) -> tuple[Array, Array]:
        """(5, J) task Jacobian and (5,) task error, both in the tip's axes."""
        jacobian = pinocchio.computeFrameJacobian(
            self._model, self._data, q, self._tip, pinocchio.LOCAL
        )
        # The Jacobian in local axes leaves the placements of the links as they were.
        pinocchio.forwardKinematics(self._model, self._data, q)
        placement = pinocchio.updateFramePlacement(self._model, self._data, self._tip)
        to_tip = placement.rotation.T
        x, y, z = to_tip @ axis
        sine = hypot(x, y)
        # Opposite axes leave the direction of the turn open; any will do, the x axis is taken.
        scale = atan2(sine, z) / sine if sine > 1e-9 else 0.0
        turn = pi if sine <= 1e-9 and z < 0 else -y * scale
        offset = to_tip @ (position - placement.translation)
        return jacobian[:5], np.array([offset[0], offset[1], offset[2], turn, x * scale])

    def _step(self, q: Array, jacobian: Array, miss: Array) -> Array:
        """Damped step that does not push joints past their limits."""
        step = _damped(jacobian, miss)
        weights = joint_weights(self._box, q, step)
        if weights is None:
            return step
        return weights * _damped(jacobian * weights, miss)


def _damped(jacobian: Array, miss: Array) -> Array:
    _, solution, _ = dposv(jacobian @ jacobian.T + _DAMPING, miss)
    return np.asarray(jacobian.T @ solution)
