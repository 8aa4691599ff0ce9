"""Openings to be measured: which object, where it stands, where the cup takes hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import numpy as np
import yaml

from flowbothd_common.errors import ParameterError
from flowbothd_common.transforms import rotation_about, transform
from flowbothd_common.types import Array
from sim_bridge.objects.model import ObjectModel
from sim_bridge.objects.registry import load_object


@dataclass(frozen=True)
class Opening:
    """One way of opening one object; everything in the base frame unless it says otherwise.

    Attributes:
        name: Of the task.
        object: Registered object.
        mode: Of an object with modes, else empty.
        sizes: Dimensions of the object that differ from its own.
        front: The cup takes hold of the face that the part moves away from, and pushes.
        position: (x, y) of the object's origin on the table [m].
        yaw: Rotation of the object about z [rad].
        grasp: (2,) distance from the hinge (of a slide: sideways from the middle of the part), and
            up, or along a level axis, from the part's middle [m].
        wanted: Joint value that counts as opened [rad or m].
        goal: Joint value at which the run stops opening [rad or m].
    """

    name: str
    object: str
    mode: str
    sizes: dict[str, float]
    front: bool
    position: tuple[float, float]
    yaw: float
    grasp: tuple[float, float]
    wanted: float
    goal: float

    @property
    def T_base_object(self) -> Array:
        """(4, 4) pose of the object."""
        return transform(rotation_about((0, 0, 1), self.yaw), (*self.position, 0.0))

    @property
    def hinged(self) -> bool:
        """Whether `wanted` and `goal` are angles."""
        return self.model().target.kind == "revolute"

    @property
    def shown_in(self) -> tuple[float, str]:
        """Factor and unit in which people read a joint value."""
        return (180 / np.pi, "deg") if self.hinged else (100.0, "cm")

    def model(self) -> ObjectModel:
        """The object, in its nominal proportions."""
        return load_object(self.object, mode=self.mode or None, seed=0, **self.sizes)

    def standing(
        self, position: tuple[float, float], yaw: float, grasp: tuple[float, float]
    ) -> Opening:
        """The same opening elsewhere."""
        return replace(self, position=position, yaw=yaw, grasp=grasp)


def key_of(opening: Opening, seed: int) -> tuple[str, int, tuple[float, ...]]:
    """Return the key of a run and its record: another pose is another run."""
    return opening.name, seed, (*opening.position, opening.yaw, *opening.grasp)


def load_openings(names: list[str] | None = None) -> dict[str, Opening]:
    """The committed openings by name, all or some.

    Raises:
        ParameterError: there is none of that name.
    """
    text = files("flowbothd_evaluation.openings").joinpath("openings.yaml").read_text()
    content = yaml.safe_load(text)
    found = {name: _opening(name, entry) for name, entry in content.items()}
    unknown = [name for name in names or () if name not in found]
    if unknown:
        raise ParameterError("unknown task", got=unknown, allowed=", ".join(found))
    return {name: found[name] for name in names or found}


def _opening(name: str, entry: Mapping[str, Any]) -> Opening:
    degrees = "wanted_deg" in entry
    unit, scale = ("_deg", np.pi / 180) if degrees else ("", 1.0)
    x, y = (float(v) for v in entry["position"])
    across, along = (float(v) for v in entry["grasp"])
    return Opening(
        name=name,
        object=entry["object"],
        mode=entry.get("mode", ""),
        sizes={key: float(value) for key, value in entry.get("sizes", {}).items()},
        front=bool(entry.get("front", False)),
        position=(x, y),
        yaw=float(np.radians(entry["yaw_deg"])),
        grasp=(across, along),
        wanted=float(entry[f"wanted{unit}"]) * scale,
        goal=float(entry[f"goal{unit}"]) * scale,
    )
