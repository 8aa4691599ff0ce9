"""The floating suction gripper of the paper's evaluation: a ball that is driven by velocity.

The object stands at the origin, its lowest point at z = 0, without gravity; base and world are the
same frame here. What the arm's motions do for the policy, `execute` does with the ball.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flowbothd_common.errors import InvalidCloudError, MotionRejectedError
from flowbothd_common.motion import MotionGoal, MotionKind, MotionReason, MotionResult
from flowbothd_common.transforms import look_at, rotation_between, transform, unit
from flowbothd_common.types import Array, Cloud, SuctionReading
from sim_bridge.ball_gripper import PARKED, BallGripper
from sim_bridge.bullet import Bullet
from sim_bridge.camera import PAPER_CAMERA, DepthCamera, DepthImage, Intrinsics
from sim_bridge.ground_truth import FlowOracle
from sim_bridge.mesh import sphere_mesh
from sim_bridge.object_world import ObjectWorld
from sim_bridge.objects.from_urdf import standing_at
from sim_bridge.objects.model import ObjectModel
from sim_bridge.physics_urdf import remove, write_object
from sim_bridge.scene import Part


@dataclass(frozen=True)
class FloatingParams:
    """The paper's rollout; `pull_steps` and `speed` make its 0.167 m a step.

    Attributes:
        time_step: [s].
        speed: Of the gripper [m/s].
        pull_steps: Simulation steps in a flow step without a distance.
        probe_steps: Simulation steps in which a probe must find contact.
        standoff: Distance from which it approaches [m].
        radius: Of the gripper [m].
        mass: Of the gripper [kg].
        grip_force: Limit of the joint that holds the part, per axis [N]: high enough not to slip.
        passes_others: The gripper passes through every link but the one that it is sent to. A ball
            that comes along the flow to the edge of a leaf touches the jamb first; the reference
            takes hold of whatever is touched, and pulls at the jamb for the rest of the trial.
        stall_fraction: A pull that moves the part by less than this share of its way has stalled.
        eye: Of the camera [m].
        look_at: What the camera looks at [m].
        camera: Its lens.
    """

    time_step: float = 1.0 / 240.0
    speed: float = 0.4
    pull_steps: int = 100
    probe_steps: int = 500
    standoff: float = 0.2
    radius: float = 0.005
    mass: float = 5.0
    grip_force: float = 2000.0
    passes_others: bool = True
    stall_fraction: float = 0.1
    eye: tuple[float, float, float] = (-2.0, 0.0, 2.0)
    look_at: tuple[float, float, float] = (0.0, 0.0, 0.5)
    camera: Intrinsics = PAPER_CAMERA


@dataclass(frozen=True)
class Observation:
    """Input of the policy.

    Attributes:
        points: (N, 3) float32 in base [m].
        links: (N,) name of the link that each point lies on; for evaluation, never for the policy.
        image: The whole picture.
    """

    points: Cloud
    links: tuple[str, ...]
    image: DepthImage


class FloatingWorld(ObjectWorld):
    """One object and one gripper; bit-identical for equal objects, seeds and calls."""

    def __init__(
        self, model: ObjectModel, seed: int = 0, params: FloatingParams | None = None
    ) -> None:
        """Build the world with the object closed.

        Args:
            model: The object.
            seed: Draws which pixels are kept as points.
            params: The rollout's numbers.
        """
        self.params = params or FloatingParams()
        self.model = model
        self.object_pose = standing_at(model, 0.0, 0.0, 0.0)
        self._oracle = FlowOracle(model)
        self._path = write_object(model)
        parts = [Part(f"object/{name}", link.meshes) for name, link in model.links.items()]
        ball = sphere_mesh(self.params.radius, (0.13, 0.45, 0.75))
        self._parts = (*parts, Part("gripper", (ball,)))
        eye = look_at(self.params.eye, self.params.look_at)
        self.camera = DepthCamera(parts, eye, self.params.camera)
        self._bullet = Bullet(self.params.time_step, gravity=0.0)
        self.reset(seed)

    def __enter__(self) -> FloatingWorld:
        """Return the world itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnect from PyBullet."""
        self.close()

    def close(self) -> None:
        """Disconnect from PyBullet and remove generated files."""
        self._bullet.close()
        remove(self._path)

    def reset(self, seed: int = 0) -> None:
        """Close the object, park the gripper, switch the suction off, restart the random draws."""
        self._rng = np.random.default_rng(seed)
        self._bullet.clear()
        self._object = self._bullet.load_object(self.model, self._path, self.object_pose)
        numbers = self.params
        self._gripper = BallGripper(
            self._bullet,
            self._object,
            radius=numbers.radius,
            mass=numbers.mass,
            grip_force=numbers.grip_force,
        )
        self._vacuum = 0.0
        self._ticks = 0
        self._bullet.update_collisions()

    @property
    def time(self) -> float:
        """Simulated time since the reset [s]."""
        return self._ticks * self.params.time_step

    def tip_pose(self) -> Array:
        """(4, 4) T_base_tip: the point of the ball that touches first, +z towards the object."""
        rotation = rotation_between((0.0, 0.0, 1.0), self._gripper.axis)
        return transform(rotation, self._gripper.tip)

    def parts(self) -> tuple[Part, ...]:
        """Everything that can be seen."""
        return self._parts

    def part_poses(self) -> dict[str, Array]:
        """(4, 4) T_base_part of everything in `parts`, now."""
        moved = self.model.displacements(self.object_positions())
        poses = {f"object/{name}": self.object_pose @ matrix for name, matrix in moved.items()}
        return {**poses, "gripper": transform(translation=self._gripper.middle)}

    def observe(self, count: int = 1200) -> Observation:
        """Take a picture and keep `count` of the object's pixels, in random order.

        The gripper is not in the picture: the reference drops its pixels. If fewer pixels show the
        object, they are repeated.

        Raises:
            InvalidCloudError: nothing of the object can be seen.
        """
        image = self.camera.render(self.part_poses())
        cloud = self.camera.cloud(image)
        if not len(cloud):
            raise InvalidCloudError(
                "nothing of the object can be seen",
                got=f"{self.model.name} from {self.params.eye}",
                hint="check eye and look_at",
            )
        order = self._rng.permutation(len(cloud))
        chosen = np.resize(order, count)
        labels = image.labels[image.depth > 0][chosen]
        names = [name.removeprefix("object/") for name in image.names]
        return Observation(cloud[chosen], tuple(names[i] for i in labels), image)

    def command_suction(self, vacuum: float) -> None:
        """Switch the suction on (any vacuum > 0) or off [Pa]; on takes hold of what is touched."""
        self._vacuum = float(vacuum)
        if vacuum <= 0:
            self._gripper.release()
        elif self._gripper.held_link is None:
            self._bullet.update_collisions()
            self._gripper.hold()

    def suction(self) -> SuctionReading:
        """Measurement of a pump in place of the ball."""
        held = self._gripper.held_link is not None
        return SuctionReading(self._vacuum if held else 0.0, held)

    def held_link(self) -> str | None:
        """Name of the link that is held."""
        link = self._gripper.held_link
        return None if link is None else self._object.link_names[link]

    def execute(self, goal: MotionGoal) -> MotionResult:
        """Do one motion to its end.

        Raises:
            MotionRejectedError: an approach without contact, or a motion without direction.
        """
        start, ticks = self.tip_pose(), self._ticks
        if goal.kind is MotionKind.RETREAT:
            self._gripper.release()
            self._gripper.place(PARKED)
            reason, fraction, message = MotionReason.REACHED, 1.0, ""
        else:
            if goal.direction is None:
                raise MotionRejectedError(f"{goal.kind} without a direction", allowed="a vector")
            try:
                direction = unit(goal.direction)
            except ValueError as error:
                raise MotionRejectedError(f"{goal.kind} without a direction: {error}") from error
            if goal.kind is MotionKind.APPROACH:
                reason, fraction, message = self._approach(goal.contact, direction)
            elif goal.kind is MotionKind.PROBE:
                reason, fraction, message = self._probe(direction, goal.distance)
            else:
                reason, fraction, message = self._pull(direction, goal.distance)
        return MotionResult(
            goal.kind,
            reason,
            message,
            float(np.clip(fraction, 0.0, 1.0)),
            start,
            self.tip_pose(),
            contact=reason in (MotionReason.CONTACT, MotionReason.VACUUM),
            vacuum=self._gripper.held_link is not None,
            duration=(self._ticks - ticks) * self.params.time_step,
        )

    def _approach(self, contact: Array | None, flow: Array) -> tuple[MotionReason, float, str]:
        if contact is None:
            raise MotionRejectedError("approach without a contact point", allowed="(3,) in base")
        self._gripper.release()
        self._gripper.axis = -flow
        self._gripper.aim_at(self._link_at(np.asarray(contact, dtype=float)))
        self._gripper.place_tip(np.asarray(contact) + self.params.standoff * flow)
        return MotionReason.REACHED, 1.0, ""

    def _probe(self, direction: Array, distance: float) -> tuple[MotionReason, float, str]:
        per_step = self.params.speed * self.params.time_step
        steps = round(distance / per_step) if distance > 0 else self.params.probe_steps
        for step in range(steps):
            self._drive(direction)
            if self._gripper.touching() is not None:
                self._stop()
                held = self._vacuum > 0 and self._gripper.hold()
                reason = MotionReason.VACUUM if held else MotionReason.CONTACT
                return reason, (step + 1) / steps, ""
        self._stop()
        return MotionReason.NO_CONTACT, 1.0, f"nothing within {steps * per_step:.3f} m"

    def _pull(self, direction: Array, distance: float) -> tuple[MotionReason, float, str]:
        if self._gripper.held_link is None:
            return MotionReason.SUCTION_LOST, 0.0, "nothing is held"
        per_step = self.params.speed * self.params.time_step
        steps = round(distance / per_step) if distance > 0 else self.params.pull_steps
        before = self._gripper.held_point()
        for _ in range(steps):
            self._drive(direction)
        self._stop()
        after = self._gripper.held_point()
        # The ball may have been drawn away from a part that could not follow: it goes back to it.
        self._gripper.place_tip(after)
        fraction = float(np.linalg.norm(after - before)) / (steps * per_step)
        if fraction < self.params.stall_fraction:
            return MotionReason.STALLED, fraction, "the part did not follow"
        return MotionReason.REACHED, fraction, ""

    def _link_at(self, contact: Array) -> int | None:
        """Id of the link that the gripper may touch: the nearest one to the contact point."""
        points = contact[None].astype(np.float32)
        nearest = int(self._oracle.owners(points, self.object_pose, self.object_positions())[0])
        if not self.params.passes_others or nearest < 0:
            return None
        return self._object.links[list(self.model.links)[nearest]]

    def _drive(self, direction: Array) -> None:
        self._gripper.drive(self.params.speed * direction)
        self._bullet.step()
        self._ticks += 1

    def _stop(self) -> None:
        self._gripper.drive(np.zeros(3))
        # The part stands still between motions, as it would at the end of a robot's step.
        self._object.set_joints(self.object_positions())
