"""Inputs of a calibration: pictures of the arm standing still, and its joints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.types import Array
from flowbothd_perception.depth import Lens

_PATTERN = "capture_*.npz"


@dataclass(frozen=True)
class Capture:
    """One pose of the arm, seen.

    Attributes:
        joint_names: J names.
        joint_positions: (J,) [rad].
        lens: Of the depth camera.
        depth: (H, W) uint16 [mm] or float32 [m], 0 = not measured.
        picture: (H, W) uint8 brightness in the same geometry (the infrared image), or None.
    """

    joint_names: tuple[str, ...]
    joint_positions: Array
    lens: Lens
    depth: NDArray[np.generic]
    picture: NDArray[np.uint8] | None = None


def save(folder: Path, captures: list[Capture]) -> None:
    """Write captures into a folder, to calibrate from them again."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, capture in enumerate(captures):
        picture = np.zeros((0, 0), np.uint8) if capture.picture is None else capture.picture
        np.savez_compressed(
            folder / f"capture_{index:02d}.npz",
            joint_names=np.array(capture.joint_names),
            joint_positions=capture.joint_positions,
            size=np.array([capture.lens.width, capture.lens.height]),
            matrix=np.array(capture.lens.matrix),
            distortion=np.array(capture.lens.distortion),
            depth=capture.depth,
            picture=picture,
        )


def load(folder: Path) -> list[Capture]:
    """Captures of a folder, in order.

    Raises:
        InvalidCloudError: there are none, or a file is not one.
    """
    files = sorted(folder.glob(_PATTERN))
    if not files:
        raise InvalidCloudError("no captures", got=str(folder), allowed=f"a folder with {_PATTERN}")
    return [_load(file) for file in files]


def _load(file: Path) -> Capture:
    try:
        with np.load(file, allow_pickle=False) as data:
            picture = data["picture"]
            return Capture(
                tuple(str(name) for name in data["joint_names"]),
                data["joint_positions"].astype(float),
                Lens(
                    int(data["size"][0]),
                    int(data["size"][1]),
                    tuple(data["matrix"].tolist()),
                    tuple(data["distortion"].tolist()),
                ),
                data["depth"],
                picture if picture.size else None,
            )
    except (KeyError, ValueError, OSError) as error:
        raise InvalidCloudError(f"{file.name} is no capture: {error}") from error
