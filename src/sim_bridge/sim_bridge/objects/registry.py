"""Objects by name, or from any PartNet-Mobility folder or URDF file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flowbothd_common.errors import ObjectModelError
from sim_bridge.objects.custom_door import MODES, CustomDoorSizes, custom_door
from sim_bridge.objects.from_urdf import model_from_urdf, standing_at
from sim_bridge.objects.furniture import (
    CabinetDoorSizes,
    DrawerSizes,
    LiddedBoxSizes,
    cabinet_door,
    drawer,
    lidded_box,
    vary,
)
from sim_bridge.objects.model import ObjectModel


@dataclass(frozen=True)
class _Entry:
    build: Callable[..., ObjectModel]
    sizes: Any
    modes: tuple[str, ...]
    # Whether the seed draws the proportions, or (for an object that hides it) the mode.
    varies: bool


_REGISTRY: dict[str, _Entry] = {
    "custom_door": _Entry(custom_door, CustomDoorSizes(), MODES, varies=False),
    "drawer": _Entry(drawer, DrawerSizes(), (), varies=True),
    "cabinet_door": _Entry(cabinet_door, CabinetDoorSizes(), ("left", "right"), varies=True),
    "lidded_box": _Entry(lidded_box, LiddedBoxSizes(), (), varies=True),
}


def object_names() -> tuple[str, ...]:
    """Names that load_object knows without a file."""
    return tuple(_REGISTRY)


def object_modes(name: str) -> tuple[str, ...]:
    """Modes of a registered object; empty where there are none, and for files."""
    return _REGISTRY[name].modes if name in _REGISTRY else ()


def load_object(
    name_or_path: str | Path, *, mode: str | None = None, seed: int = 0, **sizes: float
) -> ObjectModel:
    """Load an object.

    Args:
        name_or_path: A registered name, a PartNet-Mobility folder (holding mobility.urdf, or one
            other .urdf), or a .urdf file.
        mode: For objects with modes. If empty or None, the ambiguous door's is drawn from `seed`,
            and the cabinet's door hangs on the left.
        seed: Draws the door's mode, and the furniture's proportions (0 = nominal ones).
        sizes: Dimensions of a registered object that differ from its own, by name.

    Raises:
        ObjectModelError: unknown name, mode or dimension; unreadable or incomplete files.
    """
    name = str(name_or_path)
    if name in _REGISTRY:
        return _build(name, mode, seed, sizes)
    if mode:
        raise ObjectModelError(f"{name} has no modes", got=mode, allowed="none")
    if sizes:
        raise ObjectModelError("dimensions can be given for registered objects only", got=sizes)
    file = _urdf_file(Path(name_or_path))
    model = model_from_urdf(file, file.parent.name if file.stem == "mobility" else file.stem)
    return replace(model, seed=seed, default_pose=standing_at(model, 0.75, 0.0, 0.0))


def _build(name: str, mode: str | None, seed: int, sizes: dict[str, float]) -> ObjectModel:
    entry = _REGISTRY[name]
    if mode and mode not in entry.modes:
        raise ObjectModelError(
            f"{name} has no such mode", got=mode, allowed=list(entry.modes) or "none"
        )
    if not mode and entry.modes:
        drawn = np.random.default_rng([seed, 1]).choice(entry.modes)
        mode = entry.modes[0] if entry.varies else str(drawn)
    known = [item.name for item in fields(entry.sizes)] if is_dataclass(entry.sizes) else []
    unknown = [key for key in sizes if key not in known]
    bad = {k: v for k, v in sizes.items() if k in known and not (np.isfinite(v) and v > 0)}
    if unknown or bad:
        raise ObjectModelError(
            f"{name} cannot have these dimensions", got=bad or unknown, allowed=f"> 0 for {known}"
        )
    chosen = vary(entry.sizes, seed) if entry.varies else entry.sizes
    return entry.build(mode or "", seed, replace(chosen, **sizes))


def _urdf_file(path: Path) -> Path:
    if path.is_file() and path.suffix == ".urdf":
        return path
    if path.is_dir():
        found = sorted(path.glob("*.urdf"))
        preferred = [file for file in found if file.name == "mobility.urdf"] or found
        if len(preferred) == 1:
            return preferred[0]
        raise ObjectModelError(
            "the folder holds no single URDF",
            got=f"{len(found)} .urdf files in {path}",
            allowed="mobility.urdf, or exactly one .urdf file",
        )
    raise ObjectModelError(
        "unknown object",
        got=str(path),
        allowed=f"{', '.join(_REGISTRY)}, a folder with mobility.urdf, or a .urdf file",
    )
