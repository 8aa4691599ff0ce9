"""One PyBullet simulation without a window: bodies, rays, contacts; every call names its client."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pybullet as p

from flowbothd_common.transforms import quaternion_from_rotation, rotation_from_quaternion
from flowbothd_common.types import Array
from sim_bridge.objects.model import ObjectModel
from sim_bridge.suction_cup import SurfaceHit

ROBOT_GROUP = 1
ENVIRONMENT_GROUP = 2


@dataclass(frozen=True)
class ContactForce:
    """One contact between the robot and something else.

    Attributes:
        robot_link: Name.
        other: "table", or the object's link.
        point: (3,) in base [m].
        force: (3,) on the robot, base axes [N].
    """

    robot_link: str
    other: str
    point: Array
    force: Array

    @property
    def magnitude(self) -> float:
        """Size of the force [N]."""
        return float(np.linalg.norm(self.force))


class Body:
    """A loaded body; joints and links by name."""

    def __init__(self, client: int, body: int) -> None:
        self.id = body
        self._client = client
        self.joints: dict[str, int] = {}
        self.links: dict[str, int] = {
            p.getBodyInfo(body, physicsClientId=client)[0].decode(): -1,
        }
        for index in range(p.getNumJoints(body, physicsClientId=client)):
            info = p.getJointInfo(body, index, physicsClientId=client)
            self.joints[info[1].decode()] = index
            self.links[info[12].decode()] = index
        self.link_names = {index: name for name, index in self.links.items()}

    def joint_states(self, names: Sequence[str]) -> tuple[Array, Array]:
        """Positions and velocities of the named joints, each (J,)."""
        indices = [self.joints[name] for name in names]
        states = p.getJointStates(self.id, indices, physicsClientId=self._client)
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    def set_joints(self, positions: Mapping[str, float]) -> None:
        """Put joints somewhere, at rest."""
        for name, value in positions.items():
            p.resetJointState(self.id, self.joints[name], value, 0.0, physicsClientId=self._client)


class Bullet:
    """A stepped simulation; deterministic for equal calls."""

    def __init__(self, time_step: float, gravity: float) -> None:
        self.time_step = time_step
        self._gravity = gravity
        self.client: int = p.connect(p.DIRECT)
        self._names: dict[int, str] = {}
        self.clear()

    def clear(self) -> None:
        """Remove all bodies and start over."""
        p.resetSimulation(physicsClientId=self.client)
        p.setTimeStep(self.time_step, physicsClientId=self.client)
        p.setGravity(0, 0, -self._gravity, physicsClientId=self.client)
        # Files are generated again for every object: cached ones would only fill the memory.
        p.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1, enableFileCaching=0, physicsClientId=self.client
        )

    def close(self) -> None:
        """Disconnect; closing twice is harmless."""
        if self.client >= 0:
            p.disconnect(physicsClientId=self.client)
            self.client = -1

    def step(self) -> None:
        """Advance by one time step."""
        p.stepSimulation(physicsClientId=self.client)

    def load(self, path: Path, pose: Array, group: int, mask: int) -> Body:
        """Load a URDF with a fixed base at a (4, 4) pose and give all its links a filter group."""
        number = p.loadURDF(
            str(path),
            pose[:3, 3].tolist(),
            quaternion_from_rotation(pose[:3, :3]).tolist(),
            useFixedBase=1,
            flags=p.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=self.client,
        )
        body = Body(self.client, number)
        for link in body.link_names:
            p.setCollisionFilterGroupMask(number, link, group, mask, physicsClientId=self.client)
        return body

    def load_object(self, model: ObjectModel, path: Path, pose: Array) -> Body:
        """Load an object, closed, with the friction and damping of its joints.

        Args:
            model: The object.
            path: What `write_object` wrote of it.
            pose: T_base_object.
        """
        body = self.load(path, pose, ENVIRONMENT_GROUP, ROBOT_GROUP)
        for joint in model.joints.values():
            index = body.joints[joint.name]
            p.changeDynamics(
                body.id,
                index,
                jointDamping=joint.damping,
                linearDamping=0.0,
                angularDamping=0.0,
                physicsClientId=self.client,
            )
            # A motor that wants zero velocity with little force is Coulomb friction.
            p.setJointMotorControl2(
                body.id,
                index,
                p.VELOCITY_CONTROL,
                targetVelocity=0.0,
                force=joint.friction,
                physicsClientId=self.client,
            )
        body.set_joints(model.closed())
        return body

    def add_box(self, low: Array, high: Array) -> int:
        """Add a fixed box between two corners (3,) in base and return its body id."""
        shape = p.createCollisionShape(
            p.GEOM_BOX, halfExtents=((high - low) / 2).tolist(), physicsClientId=self.client
        )
        body: int = p.createMultiBody(
            0, shape, basePosition=((high + low) / 2).tolist(), physicsClientId=self.client
        )
        p.setCollisionFilterGroupMask(
            body, -1, ENVIRONMENT_GROUP, ROBOT_GROUP, physicsClientId=self.client
        )
        return body

    def update_collisions(self) -> None:
        """Let rays see bodies that were placed rather than stepped."""
        p.performCollisionDetection(physicsClientId=self.client)

    def cast(self, starts: Array, ends: Array) -> list[SurfaceHit | None]:
        """First hit with the environment of each of (R, 3) rays."""
        answers = p.rayTestBatch(
            starts.tolist(),
            ends.tolist(),
            numThreads=1,
            collisionFilterMask=ENVIRONMENT_GROUP,
            physicsClientId=self.client,
        )
        found: list[SurfaceHit | None] = []
        for answer, along in zip(answers, ends - starts, strict=True):
            if answer[0] < 0:
                found.append(None)
                continue
            normal = np.array(answer[4])
            # Triangles of meshes found in the wild are wound either way.
            normal = -normal if normal @ along > 0 else normal
            found.append(SurfaceHit(answer[0], answer[1], np.array(answer[3]), normal))
        return found

    def link_pose(self, body: int, link: int) -> Array:
        """(4, 4) pose of a link frame in base."""
        if link < 0:
            # PyBullet returns the base's centre of mass; its offset from the link frame is fixed.
            base = p.getBasePositionAndOrientation(body, physicsClientId=self.client)
            offset = p.getDynamicsInfo(body, -1, physicsClientId=self.client)[3:5]
            position, quaternion = p.multiplyTransforms(*base, *p.invertTransform(*offset))
        else:
            state = p.getLinkState(
                body, link, computeForwardKinematics=1, physicsClientId=self.client
            )
            position, quaternion = state[4], state[5]
        return _pose(position, quaternion)

    def link_poses(self, body: Body, names: Iterable[str]) -> dict[str, Array]:
        """(4, 4) poses of links in base, by name."""
        wanted = list(names)
        indices = [body.links[name] for name in wanted if body.links[name] >= 0]
        states = p.getLinkStates(
            body.id, indices, computeForwardKinematics=1, physicsClientId=self.client
        )
        found = {
            body.link_names[index]: _pose(state[4], state[5])
            for index, state in zip(indices, states, strict=True)
        }
        return {n: found[n] if n in found else self.link_pose(body.id, -1) for n in wanted}

    def point_velocity(self, body: int, link: int, point: Array) -> Array:
        """(3,) velocity of the link's material at a point in base [m/s]."""
        if link < 0:
            return np.zeros(3)
        state = p.getLinkState(
            body,
            link,
            computeLinkVelocity=1,
            computeForwardKinematics=1,
            physicsClientId=self.client,
        )
        arm = point - np.array(state[0])
        return np.array(state[6]) + np.cross(np.array(state[7]), arm)

    def push(self, body: int, link: int, force: Array, point: Array) -> None:
        """Apply a force (3,) at a point (3,), both in base, during the next step."""
        p.applyExternalForce(
            body, link, force.tolist(), point.tolist(), p.WORLD_FRAME, physicsClientId=self.client
        )

    def contacts(self, robot: Body, others: Mapping[int, Mapping[int, str]]) -> list[ContactForce]:
        """Forces on the robot by bodies whose link names are given, in the last step."""
        found = []
        for c in p.getContactPoints(bodyA=robot.id, physicsClientId=self.client):
            names = others.get(c[2])
            if names is None or c[9] <= 0:
                continue
            force = c[9] * np.array(c[7]) + c[10] * np.array(c[11]) + c[12] * np.array(c[13])
            found.append(ContactForce(robot.link_names[c[3]], names[c[4]], np.array(c[5]), force))
        return found


def _pose(position: Sequence[float], quaternion: Sequence[float]) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_quaternion(quaternion)
    matrix[:3, 3] = position
    return matrix
