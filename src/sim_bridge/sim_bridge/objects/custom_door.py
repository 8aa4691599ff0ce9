"""The ambiguous door: four ways to open, and nothing visible shows which."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flowbothd_common.errors import ObjectModelError
from sim_bridge.objects.boxes import BoxUrdf
from sim_bridge.objects.from_urdf import model_from_urdf, standing_at
from sim_bridge.objects.model import Joint, ObjectModel

MODES = ("pull_left", "pull_right", "push_left", "push_right")


@dataclass(frozen=True)
class CustomDoorSizes:
    """Dimensions in metres, the range in degrees, the leaf's mass in kilograms."""

    frame_width: float = 0.25
    frame_depth: float = 0.085
    frame_height: float = 0.438
    base_width: float = 0.3175
    base_depth: float = 0.36
    base_height: float = 0.0125
    leaf_width: float = 0.1683
    leaf_thickness: float = 0.0175
    leaf_height: float = 0.435
    gap: float = 0.002
    range_deg: float = 70.0
    leaf_mass: float = 0.6


def custom_door(mode: str, seed: int, sizes: CustomDoorSizes) -> ObjectModel:
    """Build the four-mode door.

    Object frame: origin under the middle of the frame, z up, the front looks along -x. The side in
    a mode's name is that of the hinge, seen from the front; pull moves the leaf to the front.
    The hinge runs along the leaf's vertical edge on the side it opens to, so that the leaf clears
    the jambs. The frame is two jambs on a base plate, without a lintel: the leaf is as high as they
    are.

    Args:
        mode: One of MODES.
        seed: Only recorded; nothing of this door is drawn.
        sizes: Dimensions.

    Raises:
        ObjectModelError: the leaf does not fit between the jambs.
    """
    jamb = (sizes.frame_width - sizes.leaf_width) / 2 - sizes.gap
    if jamb <= 0 or sizes.leaf_thickness > sizes.frame_depth:
        raise ObjectModelError(
            "the leaf does not fit into the frame",
            got=f"leaf {sizes.leaf_width} x {sizes.leaf_thickness} m",
            allowed=f"narrower than {sizes.frame_width} m, thinner than {sizes.frame_depth} m",
        )
    joints = {name: _hinge(name, sizes) for name in MODES}
    text = _urdf(sizes, jamb, joints[mode])
    model = model_from_urdf(text, "custom_door", mode=mode, seed=seed)
    return replace(
        model,
        target_joint="hinge",
        alternatives=joints,
        default_pose=standing_at(model, 0.55, 0.0, np.pi / 2),
    )


def _urdf(sizes: CustomDoorSizes, jamb: float, hinge: Joint) -> str:
    """The door with jambs of width `jamb`, its leaf on the given hinge."""
    urdf = BoxUrdf("custom_door")
    floor = sizes.base_height
    jamb_y = (sizes.frame_width - jamb) / 2
    jamb_size = (sizes.frame_depth, jamb, sizes.frame_height)
    jamb_z = floor + sizes.frame_height / 2
    urdf.link(
        "base_plate",
        [((0, 0, floor / 2), (sizes.base_depth, sizes.base_width, floor))],
        mass=3.0,
        color=(0.55, 0.55, 0.57),
    )
    urdf.link(
        "frame",
        [((0, side * jamb_y, jamb_z), jamb_size) for side in (1, -1)],
        mass=2.0,
        color=(0.86, 0.84, 0.79),
    )
    leaf_size = (sizes.leaf_thickness, sizes.leaf_width, sizes.leaf_height)
    urdf.link(
        "leaf",
        [((0, 0, jamb_z), leaf_size)],
        mass=sizes.leaf_mass,
        color=(0.80, 0.52, 0.27),
        origin=hinge.point.tolist(),
    )
    urdf.joint("frame_joint", "fixed", "base_plate", "frame", (0, 0, 1), (0, 0))
    limits = (hinge.lower, hinge.upper)
    urdf.joint("hinge", "revolute", "frame", "leaf", hinge.axis.tolist(), limits)
    return urdf.text()


def _hinge(mode: str, sizes: CustomDoorSizes) -> Joint:
    action, side = mode.split("_")
    # Seen from the front (looking along +x) the left is +y.
    y = sizes.leaf_width / 2 * (1 if side == "left" else -1)
    x = sizes.leaf_thickness / 2 * (-1 if action == "pull" else 1)
    # A positive turn about z takes a leaf that hangs from +y towards +x.
    turn = (1 if side == "left" else -1) * (1 if action == "push" else -1)
    return Joint(
        "hinge",
        "revolute",
        "leaf",
        np.array([0.0, 0.0, float(turn)]),
        np.array([x, y, sizes.base_height + sizes.frame_height / 2]),
        0.0,
        float(np.deg2rad(sizes.range_deg)),
    )
