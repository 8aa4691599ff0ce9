"""The arm's world: a table, an object, the arm with its cup; stepped, without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pybullet as p

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.motion import JointTrajectory, RobotObservation
from flowbothd_common.types import Array, SuctionReading
from sim_bridge.bullet import ENVIRONMENT_GROUP, ROBOT_GROUP, Bullet, ContactForce
from sim_bridge.ground_truth import FlowOracle
from sim_bridge.object_world import ObjectWorld
from sim_bridge.objects.model import ObjectModel
from sim_bridge.physics_urdf import remove, write_object, write_robot
from sim_bridge.scene import Part
from sim_bridge.suction_cup import CupForce, CupParams, SuctionCup
from sim_bridge.surroundings import TABLE_HIGH, TABLE_LOW, robot_meshes, static_parts
from sim_bridge.trajectory import TrajectoryFollower
from sim_bridge.urdf import Urdf, read_urdf


@dataclass(frozen=True)
class ArmWorldParams:
    """Robot of the world, and its stepping.

    Attributes:
        joint_names: The arm's joints, in order.
        start: Joint positions after a reset [rad].
        flange: All links below this one belong to the tool.
        tip: Frame of the cup's lip, +z out of the cup.
        cup_link: The soft link: it collides with nothing, the cup's spring is its contact.
        resting_links: Links that stand on the table and may touch it.
        time_step: [s].
        gravity: [m/s^2].
        start_tolerance: Largest distance of a trajectory's first point from the commanded state;
            larger than what a motion takes for the same place [rad].
        cup: Physics of the cup.
    """

    joint_names: tuple[str, ...] = tuple(f"panda_joint{i}" for i in range(1, 8))
    start: tuple[float, ...] = (
        0.0,
        -np.pi / 4,
        0.0,
        -3 * np.pi / 4,
        0.0,
        np.pi / 2,
        np.pi / 4,
    )
    flange: str = "panda_link8"
    tip: str = "suction_tip"
    cup_link: str = "suction_cup"
    resting_links: tuple[str, ...] = ("panda_link0",)
    time_step: float = 1.0 / 240.0
    gravity: float = 9.81
    start_tolerance: float = 0.03
    cup: CupParams = field(default_factory=CupParams)


class ArmWorld(ObjectWorld):
    """A stepped world with the arm; the base frame is the robot's base, the table's top is z = 0.

    The arm is position controlled within its URDF's efforts and follows its commands within a
    fraction of a millimetre: compliance has to come from the one who commands it. The cup is the
    only soft thing. The arm does not collide with itself, and the cup's own link with nothing (its
    spring is its contact); everything else of the robot collides with object and table.

    Equal calls give bit-identical states.
    """

    def __init__(
        self,
        robot_urdf: str | Path,
        model: ObjectModel,
        object_pose: Array | None = None,
        params: ArmWorldParams | None = None,
    ) -> None:
        """Build the world.

        Args:
            robot_urdf: Path, or the XML with absolute mesh paths.
            model: The object.
            object_pose: T_base_object; the model's own default pose if omitted.
            params: Names and physics.

        Raises:
            ObjectModelError: the robot's URDF lacks a joint or link that `params` names.
        """
        self.params = params or ArmWorldParams()
        text = str(robot_urdf)
        if not text.lstrip().startswith("<"):
            read_urdf(robot_urdf)
            text = Path(robot_urdf).read_text(encoding="utf-8")
        self._robot_text = text
        self._robot_urdf = read_urdf(text)
        self._check_names()
        self._robot_path = write_robot(text)
        self._tool = _below(self._robot_urdf, self.params.flange)
        self._effort = [self._robot_urdf.joints[n].effort or 100.0 for n in self.joint_names]
        self._bullet = Bullet(self.params.time_step, self.params.gravity)
        self._cup = SuctionCup(self.params.cup)
        self._follower = TrajectoryFollower(
            self.joint_names,
            np.array(self.params.start),
            start_tolerance=self.params.start_tolerance,
        )
        self.model = model
        self.object_pose = model.default_pose if object_pose is None else object_pose
        self._oracle = FlowOracle(model)
        self._object_path = write_object(model)
        self.reset()

    def __enter__(self) -> ArmWorld:
        """Return the world itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnect from PyBullet."""
        self.close()

    def close(self) -> None:
        """Disconnect from PyBullet and remove generated files."""
        self._bullet.close()
        remove(self._object_path)
        remove(self._robot_path)

    def reset(
        self,
        model: ObjectModel | None = None,
        object_pose: Array | None = None,
        joint_positions: Sequence[float] | None = None,
    ) -> None:
        """Rebuild everything: object closed, arm at rest, pump off, time zero.

        Args:
            model: Another object; the present one if omitted.
            object_pose: T_base_object. If omitted: the present pose for the present object, its
                default pose for another one.
            joint_positions: (J,) where the arm starts [rad]; the start pose if omitted.
        """
        if object_pose is None:
            object_pose = self.object_pose if model is None else model.default_pose
        if model is not None:
            self.model = model
            self._oracle = FlowOracle(model)
            remove(self._object_path)
            self._object_path = write_object(model)
        self.object_pose = np.array(object_pose, dtype=float)
        start = np.array(self.params.start if joint_positions is None else joint_positions)
        self._bullet.clear()
        self._table = self._bullet.add_box(TABLE_LOW, TABLE_HIGH)
        self._object = self._bullet.load_object(self.model, self._object_path, self.object_pose)
        self._robot = self._bullet.load(self._robot_path, np.eye(4), ROBOT_GROUP, ENVIRONMENT_GROUP)
        self._filter_robot()
        self._robot.set_joints(dict(zip(self.joint_names, start, strict=True)))
        self._others = {self._table: {-1: "table"}, self._object.id: self._object.link_names}
        self._cup.reset()
        self._follower.reset(start)
        self._ticks = 0
        self._wrench = np.zeros(6)
        self._contacts: list[ContactForce] = []
        self._worst: dict[tuple[str, str], float] = {}
        self._bullet.update_collisions()
        self._read()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The arm's joints, in the order of all joint arrays."""
        return self.params.joint_names

    @property
    def time(self) -> float:
        """Simulated time since the reset [s]."""
        return self._ticks * self.params.time_step

    def step(self, count: int = 1) -> None:
        """Advance by `count` ticks."""
        for _ in range(count):
            self._tick()

    def command_trajectory(self, trajectory: JointTrajectory, stamp: float = 0.0) -> str:
        """Follow a trajectory; returns why not, or nothing (see TrajectoryFollower.accept).

        An arm that was kept from where it should rest is taken up from where it stands.
        """
        rest = self._follower.sample(self.time).position
        pushed = np.abs(self._positions - rest).max() > self.params.start_tolerance
        if pushed and not self._follower.active(self.time):
            self._follower.reset(self._positions)
        return self._follower.accept(trajectory, self.time, stamp)

    def hold(self) -> None:
        """Come to rest quickly and smoothly, and stay."""
        self._follower.hold(self.time)

    def command_suction(self, vacuum: float) -> None:
        """Set the pump's vacuum [Pa]; 0 releases.

        Raises:
            ValueError: negative or not finite.
        """
        self._cup.command(vacuum)

    def joint_state(self) -> tuple[Array, Array]:
        """Measured positions and velocities, each (J,)."""
        return self._positions.copy(), self._velocities.copy()

    def tip_pose(self) -> Array:
        """(4, 4) T_base_tip."""
        return self._tip.copy()

    def wrench(self) -> Array:
        """(6,) force and torque of the environment on the tool, at the tip, base axes [N, Nm].

        The cup's force plus all contact forces on the links below the flange; gravity is not in it.
        """
        return self._wrench.copy()

    def suction(self) -> SuctionReading:
        """Measurement of the pump."""
        return self._cup.reading()

    @property
    def cup(self) -> SuctionCup:
        """The cup, for its tension, shear and reason of loss; command it through the world."""
        return self._cup

    def observation(self) -> RobotObservation:
        """Everything that is measured of the robot now."""
        reading = self._cup.reading()
        return RobotObservation(
            self.time,
            self._positions.copy(),
            self._velocities.copy(),
            self._wrench.copy(),
            reading.part_present,
            reading.part_detached,
        )

    def contacts(self) -> list[ContactForce]:
        """Unwanted contacts in the last tick between the robot and the object or table."""
        return list(self._contacts)

    def worst_contacts(self) -> dict[tuple[str, str], float]:
        """Largest force since the reset by (robot link, thing touched) [N]."""
        return dict(self._worst)

    def set_arm_positions(self, positions: Array) -> None:
        """Put the arm's joints somewhere, at rest; for tests and pictures."""
        self._robot.set_joints(dict(zip(self.joint_names, positions, strict=True)))
        self._follower.reset(np.array(positions, dtype=float))
        self._bullet.update_collisions()
        self._read()

    def parts(self) -> tuple[Part, ...]:
        """Everything that can be seen, each in its own frame (object parts: object, closed)."""
        things = [Part(f"object/{n}", link.meshes) for n, link in self.model.links.items()]
        return (*static_parts(self._robot_text), *things)

    def part_poses(self) -> dict[str, Array]:
        """(4, 4) T_base_part of everything in `parts`, now."""
        poses = {"table": np.eye(4)}
        for name, matrix in self.model.displacements(self.object_positions()).items():
            poses[f"object/{name}"] = self.object_pose @ matrix
        links = self._bullet.link_poses(self._robot, robot_meshes(self._robot_text))
        poses.update({f"robot/{name}": pose for name, pose in links.items()})
        return poses

    def _tick(self) -> None:
        dt = self.params.time_step
        target = self._follower.sample(self.time + dt).position
        p.setJointMotorControlArray(
            self._robot.id,
            self._joint_indices,
            p.POSITION_CONTROL,
            targetPositions=target.tolist(),
            positionGains=[1.0] * len(target),
            forces=self._effort,
            physicsClientId=self._bullet.client,
        )
        pull = self._cup.step(dt, self._tip, self._tip_velocity, self._bullet)
        if pull is not None:
            tip_link = self._robot.links[self.params.tip]
            self._bullet.push(self._robot.id, tip_link, pull.force_on_tool, self._tip[:3, 3])
            self._bullet.push(pull.body, pull.link, -pull.force_on_tool, pull.point)
        self._bullet.step()
        self._ticks += 1
        self._read()
        self._feel(pull)

    def _read(self) -> None:
        self._positions, self._velocities = self._robot.joint_states(self.joint_names)
        link = self._robot.links[self.params.tip]
        self._tip = self._bullet.link_pose(self._robot.id, link)
        self._tip_velocity = self._bullet.point_velocity(self._robot.id, link, self._tip[:3, 3])

    def _feel(self, pull: CupForce | None) -> None:
        self._contacts = self._bullet.contacts(self._robot, self._others)
        force, torque = np.zeros(3), np.zeros(3)
        if pull is not None:
            force += pull.force_on_tool
        for contact in self._contacts:
            key = contact.robot_link, contact.other
            self._worst[key] = max(self._worst.get(key, 0.0), contact.magnitude)
            if contact.robot_link in self._tool:
                force += contact.force
                torque += np.cross(contact.point - self._tip[:3, 3], contact.force)
        self._wrench = np.concatenate([force, torque])

    def _filter_robot(self) -> None:
        client, robot = self._bullet.client, self._robot
        cup = robot.links[self.params.cup_link]
        p.setCollisionFilterGroupMask(robot.id, cup, 0, 0, physicsClientId=client)
        for name in self.params.resting_links:
            p.setCollisionFilterPair(
                robot.id, self._table, robot.links[name], -1, 0, physicsClientId=client
            )
        self._joint_indices = [robot.joints[name] for name in self.joint_names]

    def _check_names(self) -> None:
        urdf, wanted = self._robot_urdf, self.params
        links = (wanted.flange, wanted.tip, wanted.cup_link, *wanted.resting_links)
        missing = [n for n in wanted.joint_names if n not in urdf.joints]
        missing += [n for n in links if n not in urdf.links]
        if missing:
            raise ObjectModelError(
                "the robot's URDF lacks what the parameters name",
                got=missing,
                allowed=[*urdf.joints, *urdf.links],
            )


def _below(urdf: Urdf, flange: str) -> frozenset[str]:
    names = {flange}
    while True:
        more = {j.child for j in urdf.joints.values() if j.parent in names} - names
        if not more:
            return frozenset(names)
        names |= more
