"""Pictures of a run's moments, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from flowbothd_evaluation.openings.part import TruePart
from flowbothd_evaluation.openings.task import Opening
from flowbothd_evaluation.openings.views import picture_view
from flowbothd_evaluation.run_record.pictures import FOV_DEG, picture_grid
from sim_bridge.render import render_rgb
from sim_bridge.world import ArmWorld

_SIZE = (400, 360)
_COLUMNS = 4
_WIDE = 5
_MOST = 8
STEP = "step"
"""How the moments are called at which the part was opened further."""


class Strip:
    """Takes a picture whenever it is told of a moment.

    Args:
        opening: Tells where pictures are taken from.
    """

    def __init__(self, opening: Opening) -> None:
        self._view = picture_view(TruePart(opening))
        self._shots: list[tuple[str, NDArray[np.uint8]]] = []

    def __call__(self, moment: str, world: ArmWorld) -> None:
        """Take a picture."""
        picture = render_rgb(world.parts(), world.part_poses(), *self._view, _SIZE, FOV_DEG)
        self._shots.append((f"{moment}, {world.time:.1f} s", picture))

    def save(self, path: Path) -> None:
        """Write at most eight of them, evenly picked, and beside them the part at its widest."""
        opened = [picture for moment, picture in self._shots if moment.startswith(STEP)]
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(opened[-1] if opened else self._shots[-1][1]).save(_widest(path))
        count = min(_MOST, len(self._shots))
        picked = np.linspace(0, len(self._shots) - 1, count).round().astype(int)
        figure, axes = picture_grid(count, _COLUMNS, (3.1, 3.0))
        for axis, index in zip(axes, picked, strict=True):
            title, picture = self._shots[index]
            axis.imshow(picture)
            axis.set_title(title, fontsize=8)
        figure.savefig(path, dpi=80)
        plt.close(figure)


def save_overview(strips: Mapping[str, Path], path: Path) -> None:
    """Write every part at its widest, side by side; of strips that were saved, by title."""
    figure, axes = picture_grid(len(strips), _WIDE, (2.0, 2.0))
    for axis, (title, strip) in zip(axes, strips.items(), strict=True):
        with Image.open(_widest(strip)) as picture:
            axis.imshow(np.asarray(picture))
        axis.set_title(title, fontsize=8)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def _widest(strip: Path) -> Path:
    return strip.with_name(f"{strip.stem}_open.png")
