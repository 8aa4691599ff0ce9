"""State of the object, shared by all stepped worlds."""

from __future__ import annotations

from flowbothd_common.types import Array
from sim_bridge.bullet import Body, Bullet
from sim_bridge.ground_truth import FlowOracle
from sim_bridge.objects.model import ObjectModel
from sim_bridge.oracle import GroundTruthFlow


class ObjectWorld:
    """The object's joints, opening and true flow; a world adds who moves it.

    Attributes:
        model: The object.
        object_pose: T_base_object.
    """

    model: ObjectModel
    object_pose: Array
    _bullet: Bullet
    _object: Body
    _oracle: FlowOracle

    def object_positions(self) -> dict[str, float]:
        """Position of every movable joint of the object [rad or m]."""
        names = list(self.model.joints)
        values, _ = self._object.joint_states(names)
        return dict(zip(names, values.tolist(), strict=True))

    def set_object_positions(self, positions: dict[str, float]) -> None:
        """Put joints of the object somewhere, at rest; for tests, pictures and starts."""
        self._object.set_joints(positions)
        self._bullet.update_collisions()

    def open_ratios(self) -> dict[str, float]:
        """0 = closed, 1 = open, by joint."""
        at = self.object_positions()
        return {name: joint.open_ratio(at[name]) for name, joint in self.model.joints.items()}

    @property
    def open_ratio(self) -> float:
        """Open ratio of the target joint."""
        return self.open_ratios()[self.model.target_joint]

    def ground_truth_flow(self, points: object, *, target_only: bool = False) -> GroundTruthFlow:
        """True flow of (N, 3) points in base; see FlowOracle.flow."""
        return self._oracle.flow(
            points, self.object_pose, self.object_positions(), target_only=target_only
        )
