"""The ball that stands for a suction cup in the paper's evaluation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pybullet as p

from flowbothd_common.transforms import apply, inverse, transform
from flowbothd_common.types import Array
from sim_bridge.bullet import ENVIRONMENT_GROUP, ROBOT_GROUP, Body, Bullet

PARKED = np.array([-5.0, 0.0, 5.0])
"""Where the ball waits, out of everybody's way (3,) [m]."""


@dataclass(frozen=True)
class _Grasp:
    """Held part: link id, the point in that link's frame, the constraint."""

    link: int
    local: Array
    constraint: int


class BallGripper:
    """A ball that is moved by setting its velocity, and sticks to what it touches.

    While it holds, it does not collide with the object: left on, it wedges itself against the part
    that it pulls (17 of 25 openings instead of 25).
    """

    def __init__(
        self, bullet: Bullet, thing: Body, *, radius: float, mass: float, grip_force: float
    ) -> None:
        """Put the ball into a simulation, parked.

        Args:
            bullet: The simulation.
            thing: The object that it works on.
            radius: [m].
            mass: [kg].
            grip_force: Limit of the joint that holds the part, per axis [N].
        """
        self._bullet = bullet
        self._thing = thing
        self._radius = radius
        self._force = grip_force
        client = bullet.client
        shape = p.createCollisionShape(p.GEOM_SPHERE, radius=radius, physicsClientId=client)
        self._ball: int = p.createMultiBody(mass, shape, physicsClientId=client)
        p.changeDynamics(
            self._ball, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client
        )
        self._grasp: _Grasp | None = None
        self._aim: int | None = None
        self.axis: Array = np.array([1.0, 0.0, 0.0])
        self._set_collisions(on=True)
        self.place(PARKED)

    @property
    def middle(self) -> Array:
        """(3,) centre of the ball in base [m]."""
        return self._bullet.link_pose(self._ball, -1)[:3, 3]

    @property
    def tip(self) -> Array:
        """(3,) the point of the ball that touches first when it moves along `axis`."""
        return self.middle + self._radius * self.axis

    @property
    def held_link(self) -> int | None:
        """Id of the link that is held."""
        return None if self._grasp is None else self._grasp.link

    def held_point(self) -> Array:
        """(3,) where the part is held, moving with the part; the tip if nothing is held."""
        grasp = self._grasp
        if grasp is None:
            return self.tip
        return apply(self._bullet.link_pose(self._thing.id, grasp.link), grasp.local)

    def aim_at(self, link: int | None) -> None:
        """Touch only this link from now on; None = every link."""
        self._aim = link
        self._set_collisions(on=True)

    def place(self, middle: Array) -> None:
        """Put the ball somewhere, at rest."""
        client = self._bullet.client
        p.resetBasePositionAndOrientation(
            self._ball, middle.tolist(), [0, 0, 0, 1], physicsClientId=client
        )
        self.drive(np.zeros(3))

    def place_tip(self, point: Array) -> None:
        """Put the ball so that its tip is at a point (3,)."""
        self.place(point - self._radius * self.axis)

    def drive(self, velocity: Array) -> None:
        """Set the ball's velocity (3,) for the next step [m/s]."""
        p.resetBaseVelocity(
            self._ball, velocity.tolist(), [0, 0, 0], physicsClientId=self._bullet.client
        )

    def touching(self) -> tuple[int, Array] | None:
        """Link id and point (3,) of the deepest contact with the object."""
        points = p.getContactPoints(self._ball, self._thing.id, physicsClientId=self._bullet.client)
        touching = [c for c in points if c[8] <= 0.0]
        if not touching:
            return None
        deepest = min(touching, key=lambda c: (c[8], c[4]))
        return deepest[4], np.array(deepest[6])

    def hold(self) -> bool:
        """Stick to what is touched; False if nothing is."""
        touched = self.touching()
        if touched is None:
            return False
        link, point = touched
        client = self._bullet.client
        self.place_tip(point)
        # Constraint frames are those of the centre of mass.
        centre = self._centre_of_mass(link)
        constraint = p.createConstraint(
            self._ball,
            -1,
            self._thing.id,
            link,
            p.JOINT_POINT2POINT,
            [0, 0, 0],
            (self._radius * self.axis).tolist(),
            apply(inverse(centre), point).tolist(),
            physicsClientId=client,
        )
        p.changeConstraint(constraint, maxForce=self._force, physicsClientId=client)
        local = apply(inverse(self._bullet.link_pose(self._thing.id, link)), point)
        self._grasp = _Grasp(link, local, constraint)
        self._set_collisions(on=False)
        return True

    def release(self) -> None:
        """Let go; harmless if nothing is held."""
        if self._grasp is not None:
            p.removeConstraint(self._grasp.constraint, physicsClientId=self._bullet.client)
            self._grasp = None
            self._set_collisions(on=True)

    def _centre_of_mass(self, link: int) -> Array:
        if link < 0:
            return self._bullet.link_pose(self._thing.id, link)
        state = p.getLinkState(self._thing.id, link, physicsClientId=self._bullet.client)
        rotation = np.array(p.getMatrixFromQuaternion(state[1])).reshape(3, 3)
        return transform(rotation, state[0])

    def _set_collisions(self, *, on: bool) -> None:
        client = self._bullet.client
        mask = ENVIRONMENT_GROUP if on else 0
        p.setCollisionFilterGroupMask(self._ball, -1, ROBOT_GROUP, mask, physicsClientId=client)
        for link in self._thing.link_names:
            wanted = int(on and self._aim in (None, link))
            p.setCollisionFilterPair(
                self._ball, self._thing.id, -1, link, wanted, physicsClientId=client
            )
