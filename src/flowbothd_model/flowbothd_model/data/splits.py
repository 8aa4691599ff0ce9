"""Which objects are trained on and which are only for validation."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

NEVER_TRAINED_ON = ("8994", "41083")
"""The two objects of the demonstrations; they are in neither split."""


def held_out_ids() -> tuple[str, ...]:
    """PartNet-Mobility ids that are kept whole for validation (data/held_out.json)."""
    text = files("flowbothd_model.data").joinpath("held_out.json").read_text(encoding="utf-8")
    return tuple(str(name) for name in json.loads(text)["ids"])


def split_folders(root: Path) -> tuple[list[Path], list[Path]]:
    """Training and validation folders of a PartNet-Mobility download.

    Args:
        root: Holds one folder per object, named by its id.

    Raises:
        FileNotFoundError: there is no object in `root`.
    """
    folders = (
        sorted(p for p in root.iterdir() if (p / "mobility.urdf").is_file())
        if root.is_dir()
        else []
    )
    if not folders:
        raise FileNotFoundError(f"no PartNet-Mobility object (id/mobility.urdf) in {root}")
    held_out = set(held_out_ids())
    kept = [p for p in folders if p.name not in NEVER_TRAINED_ON]
    return [p for p in kept if p.name not in held_out], [p for p in kept if p.name in held_out]
