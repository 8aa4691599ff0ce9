"""Every touch of the arm but the cup's on the part: which link, what, how hard, and when."""

from __future__ import annotations

from dataclasses import dataclass

from flowbothd_common.types import Array
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.planning.collision import CollisionChecker, Margins
from sim_bridge.world import ArmWorld


@dataclass
class Touched:
    """One pair of things that touched.

    Attributes:
        link: Of the robot.
        thing: Link of the object, table, or another link of the robot.
        phase: In which part of the run it was hardest.
        time: When it began [s].
        peak: Largest force [N]; 0 for the arm on itself, which the physics does not know.
    """

    link: str
    thing: str
    phase: str
    time: float
    peak: float


class TouchLog:
    """Collects touches; to be asked to look once a control period.

    Args:
        world: Counts forces of the arm with object and table in every tick of its own.
        kinematics: For the arm with itself, by the convex hulls of its links.
    """

    def __init__(self, world: ArmWorld, kinematics: Kinematics) -> None:
        self._world = world
        self._itself = CollisionChecker(kinematics, Margins(0.0, 0.0, 0.0), table_height=None)
        self.touches: dict[tuple[str, str], Touched] = {}

    def look(self, phase: str) -> None:
        """Note what has touched since the last look."""
        for (link, thing), force in self._world.worst_contacts().items():
            self._note(link, thing, phase, force)
        positions, _ = self._world.joint_state()
        touch = self._self_touch(positions)
        if touch is not None:
            self._note(*touch, phase, 0.0)

    def _self_touch(self, positions: Array) -> tuple[str, str] | None:
        if self._itself.free(positions):
            return None
        touch = self._itself.touch(positions)
        return None if touch is None else (touch.first, touch.second)

    def _note(self, link: str, thing: str, phase: str, force: float) -> None:
        known = self.touches.get((link, thing))
        if known is None:
            self.touches[link, thing] = Touched(link, thing, phase, self._world.time, force)
        elif force > known.peak:
            known.phase, known.peak = phase, force
