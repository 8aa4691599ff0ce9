"""A suction cup as a spring-damper with a vacuum, a seal and ways to come off.

Never a constraint: PyBullet's constraints limit force per axis, transmit torque, or break from a
misfit of a fraction of a millimetre, and saturate where a force sensor is wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flowbothd_common.transforms import angle_between, apply, inverse, rotation_between, transform
from flowbothd_common.types import Array, SuctionReading


@dataclass(frozen=True)
class CupParams:
    """Physics of the cup; forces at `nominal_vacuum`.

    Attributes:
        stiffness: In every direction [N/m].
        damping: [Ns/m].
        radius: Of the lip [m].
        break_tension: Pull that tears it off, low-passed [N].
        break_shear: The same across [N].
        force_time_constant: Of the low-pass [s].
        tilt_limit_deg: Between tool axis and surface normal; beyond it the lip peels.
        attach_gap: Largest distance from lip to surface at which it seals [m].
        attach_tilt_deg: Largest tilt at which it seals.
        seal_tolerance: How far the surface under the rim may lie off the plane [m].
        seal_fraction: Share of the rim that must lie on the surface.
        rim_samples: Points of the rim that are looked at.
        grace: Time after sealing in which nothing tears [s].
        nominal_vacuum: [Pa].
        free_fraction: Share of the commanded vacuum that an open cup still draws.
        build_time: Time constant of building up vacuum [s].
        vent_time: Time constant of losing it [s].
        present_fraction: Share of the commanded vacuum that counts as part present.
        reach: How deep the cup looks behind its lip for what it is pressed into [m].
    """

    stiffness: float = 3000.0
    damping: float = 25.0
    radius: float = 0.015
    break_tension: float = 40.0
    break_shear: float = 32.0
    force_time_constant: float = 0.02
    tilt_limit_deg: float = 30.0
    attach_gap: float = 0.003
    attach_tilt_deg: float = 25.0
    seal_tolerance: float = 0.002
    seal_fraction: float = 0.9
    rim_samples: int = 16
    grace: float = 0.15
    nominal_vacuum: float = 60_000.0
    free_fraction: float = 0.08
    build_time: float = 0.03
    vent_time: float = 0.04
    present_fraction: float = 0.6
    reach: float = 0.03


@dataclass(frozen=True)
class SurfaceHit:
    """Hit of a ray: a body and link id, point and outward normal, (3,) in base."""

    body: int
    link: int
    point: Array
    normal: Array


class Surroundings(Protocol):
    """Physics around the cup; implemented by the world."""

    def cast(self, starts: Array, ends: Array) -> Sequence[SurfaceHit | None]:
        """First hit of each of (R, 3) rays that is not the robot's own."""
        ...

    def link_pose(self, body: int, link: int) -> Array:
        """(4, 4) pose of a link in base."""
        ...

    def point_velocity(self, body: int, link: int, point: Array) -> Array:
        """(3,) velocity of the link's material at a point in base [m/s]."""
        ...


@dataclass(frozen=True)
class CupForce:
    """Force on the tool at its tip, and the opposite one on a link at `point`; (3,) in base."""

    body: int
    link: int
    point: Array
    force_on_tool: Array


@dataclass(frozen=True)
class _Hold:
    """Held part: the link, and in its frame the anchor of the spring and the outward normal."""

    body: int
    link: int
    anchor: Array
    normal: Array


class SuctionCup:
    """One cup: call `command` when the pump is switched, `step` once per tick."""

    def __init__(self, params: CupParams | None = None) -> None:
        self.params = params or CupParams()
        self.reset()

    def reset(self) -> None:
        """Pump off, nothing held, no vacuum."""
        self._vacuum = 0.0
        self._reached_vacuum = 0.0
        self._detached = False
        self._hold: _Hold | None = None
        self._held_for = 0.0
        self._tension = 0.0
        self._shear = 0.0
        self.loss_reason = ""

    def command(self, vacuum: float) -> None:
        """Set the vacuum [Pa]; 0 releases the part, switches off and clears `part_detached`.

        Raises:
            ValueError: negative or not finite.
        """
        if not (np.isfinite(vacuum) and vacuum >= 0):
            raise ValueError(f"vacuum must be >= 0 Pa, got {vacuum}")
        self._vacuum = float(vacuum)
        if vacuum == 0:
            self._hold = None
            self._detached = False
            self.loss_reason = ""

    @property
    def attached(self) -> bool:
        """The cup holds something."""
        return self._hold is not None

    @property
    def held_link(self) -> tuple[int, int] | None:
        """Body and link id of what is held."""
        return None if self._hold is None else (self._hold.body, self._hold.link)

    @property
    def tension(self) -> float:
        """Low-passed pull on the lip [N]; negative while pressed."""
        return self._tension

    @property
    def shear(self) -> float:
        """Low-passed force across the lip [N]."""
        return self._shear

    def reading(self) -> SuctionReading:
        """Return the pump's measurement."""
        enough = self._reached_vacuum >= self.params.present_fraction * max(self._vacuum, 1.0)
        return SuctionReading(self._reached_vacuum, self.attached and enough, self._detached)

    def step(self, dt: float, tip: Array, velocity: Array, world: Surroundings) -> CupForce | None:
        """Advance by `dt`.

        Args:
            dt: [s].
            tip: (4, 4) pose of the lip in base, +z out of the cup.
            velocity: (3,) of the tip [m/s].
            world: What surrounds it.

        Returns:
            The force to apply during this tick, or None if nothing is touched.
        """
        if self._hold is None and self._vacuum > 0 and not self._detached:
            self._try_to_seal(tip, world)
        self._update_vacuum(dt)
        if self._hold is None:
            return self._press(tip, velocity, world)
        return self._pull(self._hold, dt, tip, velocity, world)

    def _update_vacuum(self, dt: float) -> None:
        if self._vacuum == 0:
            goal, constant = 0.0, self.params.vent_time
        elif self.attached:
            goal, constant = self._vacuum, self.params.build_time
        else:
            goal = self._vacuum * self.params.free_fraction
            constant = self.params.vent_time
        self._reached_vacuum += (goal - self._reached_vacuum) * (
            1.0 - float(np.exp(-dt / constant))
        )

    def _look(self, tip: Array, world: Surroundings) -> tuple[SurfaceHit | None, float]:
        """Surface in front of the lip's centre and its distance [m], negative if pressed in."""
        axis, middle = tip[:3, 2], tip[:3, 3]
        start = middle - self.params.reach * axis
        end = middle + self.params.attach_gap * axis
        hit = world.cast(start[None], end[None])[0]
        return hit, 0.0 if hit is None else float((hit.point - middle) @ axis)

    def _try_to_seal(self, tip: Array, world: Surroundings) -> None:
        hit, gap = self._look(tip, world)
        if hit is None or gap > self.params.attach_gap:
            return
        tilt = np.rad2deg(angle_between(-tip[:3, 2], hit.normal))
        if tilt > self.params.attach_tilt_deg or not self._rim_seals(tip, hit, world):
            return
        # The spring starts without force: a bellows seals in the shape in which it touches.
        to_link = inverse(world.link_pose(hit.body, hit.link))
        anchor = apply(to_link, tip[:3, 3].copy())
        self._hold = _Hold(hit.body, hit.link, anchor, to_link[:3, :3] @ hit.normal)
        self._held_for = self._tension = self._shear = 0.0

    def _rim_seals(self, tip: Array, hit: SurfaceHit, world: Surroundings) -> bool:
        p = self.params
        # The lip lies down on the surface: the rim is looked at in the surface's plane.
        laid = transform(rotation_between(tip[:3, 2], -hit.normal) @ tip[:3, :3], hit.point)
        angles = 2 * np.pi * np.arange(p.rim_samples) / p.rim_samples
        circle = p.radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
        rim = apply(laid, circle)
        depth = max(2 * p.seal_tolerance, p.attach_gap)
        hits = world.cast(rim + depth * hit.normal, rim - depth * hit.normal)
        good = sum(
            found is not None
            and (found.body, found.link) == (hit.body, hit.link)
            and abs(float((found.point - hit.point) @ hit.normal)) <= p.seal_tolerance
            for found in hits
        )
        return good >= p.seal_fraction * p.rim_samples

    def _press(self, tip: Array, velocity: Array, world: Surroundings) -> CupForce | None:
        hit, gap = self._look(tip, world)
        if hit is None or gap >= 0:
            return None
        closing = (velocity - world.point_velocity(hit.body, hit.link, hit.point)) @ tip[:3, 2]
        size = max(0.0, -self.params.stiffness * gap + self.params.damping * float(closing))
        return CupForce(hit.body, hit.link, hit.point, -size * tip[:3, 2])

    def _pull(
        self, hold: _Hold, dt: float, tip: Array, velocity: Array, world: Surroundings
    ) -> CupForce | None:
        p = self.params
        pose = world.link_pose(hold.body, hold.link)
        anchor, normal = apply(pose, hold.anchor), pose[:3, :3] @ hold.normal
        slip = world.point_velocity(hold.body, hold.link, anchor) - velocity
        force = p.stiffness * (anchor - tip[:3, 3]) + p.damping * slip
        pull = float(-force @ normal)
        across = float(np.linalg.norm(force + pull * normal))
        share = 1.0 - float(np.exp(-dt / p.force_time_constant))
        self._tension += (pull - self._tension) * share
        self._shear += (across - self._shear) * share
        self._held_for += dt
        self.loss_reason = self._reason_to_come_off(tip, normal)
        if self.loss_reason:
            self._hold = None
            self._detached = True
            return None
        return CupForce(hold.body, hold.link, anchor, force)

    def _reason_to_come_off(self, tip: Array, normal: Array) -> str:
        p = self.params
        if self._held_for < p.grace:
            return ""
        strength = self._vacuum / p.nominal_vacuum
        if self._tension > p.break_tension * strength:
            return f"pulled off with {self._tension:.1f} N"
        if self._shear > p.break_shear * strength:
            return f"sheared off with {self._shear:.1f} N"
        tilt = float(np.rad2deg(angle_between(-tip[:3, 2], normal)))
        if tilt > p.tilt_limit_deg:
            return f"peeled off at {tilt:.1f} degrees of tilt"
        return ""
