"""Recorded clouds through outlier removal, sampling and the network, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import open3d as o3d

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.transforms import look_at
from flowbothd_common.types import Array, Cloud, History
from flowbothd_perception.crop import to_base
from flowbothd_perception.frame import CloudFrame
from flowbothd_perception.outliers import inliers
from flowbothd_perception.params import CropParams, OutlierParams
from flowbothd_perception.sampling import sample
from flowbothd_policy.predictor import FlowPredictor

POINTS = 1200

_LEVEL = look_at((-1.0, 0.0, 0.3), (0.0, 0.0, 0.3))
"""A level camera: its clouds have y down."""


@dataclass(frozen=True)
class Recorded:
    """One recorded cloud as the network gets it.

    Attributes:
        name: For the picture.
        points: (N, 3) sampled, upright.
        measured: How many points there were.
        history: What was seen and moved before, if it was recorded.
    """

    name: str
    points: Cloud
    measured: int
    history: History | None = None


def read_recorded(folder: Path) -> list[Recorded]:
    """The clouds of a folder like `real_clouds`: a door in base, a microwave in camera frame.

    Raises:
        InvalidCloudError: the folder lacks them.
    """
    door, microwave = folder / "custom_door", folder / "microwave"
    missing = [str(path) for path in (door, microwave) if not path.is_dir()]
    if missing:
        raise InvalidCloudError("recorded clouds are missing", got=", ".join(missing))
    result = [_door(door)]
    for file in sorted(microwave.glob("*.ply")):
        points = np.asarray(o3d.io.read_point_cloud(file).points, dtype=np.float32)
        result.append(sampled(file.stem.replace("_", ", "), points, _LEVEL))
    return result


def sampled(name: str, points: Cloud, T_base_camera: Array, seed: int = 0) -> Recorded:
    """Crop (a wide box), outlier removal and sampling of a cloud in the optical frame."""
    wide = CropParams(min_corner=(-5.0, -5.0, -5.0), max_corner=(5.0, 5.0, 5.0))
    frame = CloudFrame(points)
    left = to_base(T_base_camera, frame.points(frame.inside(T_base_camera, wide)))
    left = left[inliers(left, OutlierParams())]
    chosen = left[sample(len(left), POINTS, np.random.default_rng(seed))]
    return Recorded(name, chosen, len(points))


def _door(folder: Path) -> Recorded:
    now, before, flow = (
        np.load(folder / f"{name}.npy").astype(np.float32)
        for name in ("current_pcd", "history_pcd", "history_flow")
    )
    return Recorded("door, with its last step", now, len(now), History(before, flow))


def draw_recorded(
    recorded: Sequence[Recorded], predictor: FlowPredictor, path: Path, samples: int = 3
) -> None:
    """Clouds in rows, samples of their flow in columns; blue rests, red moves, arrows say where."""
    figure = plt.figure(figsize=(3.2 * (samples + 1), 3.0 * len(recorded)))
    for row, item in enumerate(recorded):
        flows = predictor.sample(item.points, item.history, samples=samples, seed=0)
        for column in range(samples + 1):
            axes = figure.add_subplot(
                len(recorded), samples + 1, row * (samples + 1) + column + 1, projection="3d"
            )
            _draw(axes, item, None if column == 0 else flows[column - 1])
            axes.set_title(
                f"{item.name}\n{len(item.points)} of {item.measured} points"
                if column == 0
                else f"sample {column}",
                fontsize=8,
            )
    figure.subplots_adjust(left=0, right=1, bottom=0, top=0.94, wspace=0, hspace=0.12)
    figure.savefig(path, dpi=70)
    plt.close(figure)


def _draw(axes: Any, item: Recorded, flow: Cloud | None) -> None:
    points = item.points
    norm = np.zeros(len(points)) if flow is None else np.linalg.norm(flow, axis=1)
    axes.scatter(*points.T, c=norm, cmap="coolwarm", vmin=0, vmax=1, s=2, linewidths=0)
    if flow is not None:
        moving = np.flatnonzero(norm > 0.2)[:: max(1, len(points) // 60)]
        size = 0.25 * float(np.ptp(points, axis=0).max())
        axes.quiver(*points[moving].T, *(size * flow[moving]).T, color="k", linewidth=0.5)
    axes.set_box_aspect(np.ptp(points, axis=0) + 1e-3)
    axes.view_init(elev=18, azim=-150)
    axes.set_axis_off()
