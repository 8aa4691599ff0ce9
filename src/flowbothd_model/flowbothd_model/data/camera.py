"""Camera poses and their depth images: the published views and those of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from flowbothd_common.transforms import unit
from flowbothd_common.types import Array


class ViewPreset(StrEnum):
    """A family of views."""

    PAPER = "paper"
    ROBOT = "robot"


@dataclass(frozen=True)
class View:
    """One sampled view of an object that stands on z = 0 with its front towards -x.

    Attributes:
        T_camera_object: (4, 4) object frame to optical frame (x right, y down, z forwards).
        width: Image columns.
        height: Image rows.
        focal: Focal length, both axes [pixel].
        depth_noise: Standard deviation of the depth at 1 m, growing with the square of z [m].
        flying: Share of the pixels at depth edges that fly between fore- and background.
        cut: Share of the object that a partial view may lose at one side, 0 = all is kept.
        floor: Points below this height of the object frame are lost with the table [m].
        arm: Length units per metre of the robot's arm that may hide part of the object
            (arm_shadow.py), 0 = no arm.
    """

    T_camera_object: Array
    width: int
    height: int
    focal: float
    depth_noise: float = 0.0
    flying: float = 0.0
    cut: float = 0.0
    floor: float = -np.inf
    arm: float = 0.0


def look_at(eye: Array, target: Array) -> Array:
    """(4, 4) world to optical frame of a camera at `eye` (3,) looking at `target` (3,), z up."""
    forward = unit(target - eye)
    right = unit(np.cross(forward, np.array([0.0, 0.0, 1.0])))
    rotation = np.stack((right, np.cross(forward, right), forward))
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = -rotation @ eye
    return result


def paper_view(rng: np.random.Generator) -> View:
    """The published random camera: sqrt(8) m away, looking at (0, 0, 0.5) (reference_network 3)."""
    azimuth, elevation = np.radians(rng.uniform(30, 150)), np.radians(rng.uniform(30, 60))
    r = np.sqrt(8.0)
    eye = r * np.array(
        [
            -np.cos(elevation) * np.sin(azimuth),
            np.cos(azimuth),
            np.sin(elevation) * np.sin(azimuth),
        ]
    )
    return View(look_at(eye, np.array([0.0, 0.0, 0.5])), 640, 480, 450.0)


def robot_view(
    rng: np.random.Generator, low: Array, high: Array, arm: float = 0.0, table: float = 0.0
) -> View:
    """A tabletop view of an object between the corners `low` and `high` (3,) [m].

    The camera of a robot stands lower and further to the side than the published one, near enough
    that the object may leave the image, and measures by time of flight: noise that grows with
    distance, and flying pixels at the edges. Distances follow the object's size, since the small
    objects of a table and the metre-sized ones of PartNet are the same to the network.

    Args:
        rng: Of the view.
        low: (3,) smallest coordinates of the object.
        high: (3,) largest.
        arm: Share of views in which the arm may stand before the object.
        table: Share of views in which the object's lowest centimetres go with the table.
    """
    size = float(np.linalg.norm(high - low))
    azimuth, elevation = np.radians(rng.uniform(-80, 80)), np.radians(rng.uniform(2, 65))
    distance = size * rng.uniform(0.9, 2.0)
    direction = np.array(
        [
            -np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    target = (low + high) / 2 + rng.normal(0.0, 0.06, 3) * (high - low)
    metres_per_unit = rng.uniform(0.3, 1.5) / size
    noise = rng.uniform(0.0005, 0.003) * metres_per_unit  # at 1 m: 0.5 to 3 mm, in object units
    cut = float(rng.uniform(0.05, 0.3)) if rng.random() < 0.25 else 0.0
    # What perception takes for the table goes with it, a thin base plate too.
    lost = float(rng.uniform(0.005, 0.03)) if rng.random() < table else -np.inf
    return View(
        look_at(target + distance * direction, target),
        640,
        576,
        float(rng.uniform(480, 620)),
        depth_noise=float(noise),
        flying=float(rng.uniform(0.0, 0.3)),
        cut=cut,
        floor=float(low[2]) + lost / metres_per_unit,
        arm=1.0 / metres_per_unit if rng.random() < arm else 0.0,
    )
