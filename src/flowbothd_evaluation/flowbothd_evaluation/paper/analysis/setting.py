"""An object before the published camera, with one joint to be opened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flowbothd_common.errors import ObjectModelError
from flowbothd_common.types import Array
from flowbothd_model.data.articulated import ArticulatedObject
from flowbothd_model.data.camera import View, look_at
from flowbothd_model.data.observation import Observation, observe

POINTS = 1200
"""Points of a cloud, as published."""

_TARGET = (0.0, 0.0, 0.5)
_AZIMUTHS = tuple(range(30, 151, 15))
_LOW = 30.0


@dataclass(frozen=True)
class Setting:
    """One object with one joint that opens, seen by a camera that stays where it is.

    Attributes:
        item: The object.
        joint: Index of the joint.
        azimuth: Of the camera [deg]; 90 is straight in front, the published ones are 30 to 150.
        elevation: Of the camera [deg]; 90 and 45 give the published evaluation's (-2, 0, 2).
    """

    item: ArticulatedObject
    joint: int
    azimuth: float = 90.0
    elevation: float = 45.0

    @property
    def lift(self) -> float:
        """How far the closed object is raised to stand on z = 0 [m]."""
        return -float(self.item.posed_vertices(self.item.closed())[:, 2].min())

    def positions(self, ratio: float) -> Array:
        """(L,) joint positions with the joint open by `ratio` and everything else closed."""
        result = self.item.closed()
        joint = self.item.joints[self.joint]
        result[self.joint] = joint.lower + ratio * (joint.upper - joint.lower)
        return result

    def view(self) -> View:
        """The camera: sqrt(8) m from the object, looking at (0, 0, 0.5) (reference_network 3)."""
        azimuth, elevation = np.radians(self.azimuth), np.radians(self.elevation)
        eye = np.sqrt(8.0) * np.array(
            [
                -np.cos(elevation) * np.sin(azimuth),
                np.cos(azimuth),
                np.sin(elevation) * np.sin(azimuth),
            ]
        )
        standing = np.eye(4)
        standing[2, 3] = self.lift
        return View(look_at(eye, np.array(_TARGET)) @ standing, 640, 480, 450.0)

    def see(self, ratio: float, seed: int, points: int = POINTS) -> Observation | None:
        """The cloud at `ratio` and its truth, object frame; None if nothing that moves is seen.

        The truth is the published one: all joints open at once.
        """
        rng = np.random.default_rng([seed, round(1e6 * ratio)])
        return observe(self.item, self.positions(ratio), self.view(), points, rng)

    def on_part(self, seen: Observation) -> int:
        """How many points of the cloud lie on the part that the joint moves."""
        moved = {self.joint}
        for index, joint in enumerate(self.item.joints):
            if joint.parent in moved:
                moved.add(index)
        return int(np.isin(seen.link, list(moved)).sum())


def main_joint(item: ArticulatedObject) -> int:
    """The joint that moves the largest part; knobs and buttons open too, but nobody means them.

    Raises:
        ObjectModelError: no movable joint carries a shape.
    """
    sizes = {}
    for index in item.movable:
        own = item.vertices[item.vertex_link == index]
        if len(own):
            sizes[index] = float(np.linalg.norm(own.max(0) - own.min(0)))
    if not sizes:
        raise ObjectModelError(f"{item.name} has no movable part with a shape")
    return max(sizes, key=lambda index: (round(sizes[index], 6), -index))


def setting_of(item: ArticulatedObject, **camera: float) -> Setting:
    """The object with its main joint, before the camera of the published evaluation."""
    return Setting(item, main_joint(item), **camera)


def most_occluded(setting: Setting, ratios: Sequence[float], seed: int) -> Setting:
    """The setting with the published camera that comes nearest to seeing the part edge-on.

    Of the published azimuths, 15 degrees apart and at the lowest published elevation: the one in
    whose clouds the part has the fewest points at some of `ratios`, while it can be seen well when
    it is closed.
    """
    candidates = [replace(setting, azimuth=float(a), elevation=_LOW) for a in _AZIMUTHS]
    return min(candidates, key=lambda one: (_least(one, ratios, seed), abs(one.azimuth - 90.0)))


def _least(setting: Setting, ratios: Sequence[float], seed: int) -> float:
    """Least share of the part's points over `ratios` against the closed part."""
    closed = setting.see(0.0, seed)
    if closed is None or setting.on_part(closed) < POINTS / 10:
        return np.inf
    seen = [setting.see(ratio, seed) for ratio in ratios]
    counts = [setting.on_part(one) if one is not None else 0 for one in seen]
    return min(counts) / setting.on_part(closed)
