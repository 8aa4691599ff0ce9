"""Pictures of a run: a strip of its decisive moments with flows drawn in, and an animation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from flowbothd_common.transforms import apply, inverse, look_at
from flowbothd_common.types import Array
from flowbothd_evaluation.run_record.record import PredictionSample, RunRecord, StateSample
from sim_bridge.render import render_rgb
from sim_bridge.world import ArmWorld

FOV_DEG = 40.0
ARROW = 0.09
"""Length of the longest flow arrow [m]."""


@dataclass(frozen=True)
class View:
    """Where pictures are taken from, in base [m]."""

    eye: tuple[float, ...]
    target: tuple[float, ...]
    size: tuple[int, int] = (400, 360)

    def project(self, points: NDArray[np.floating]) -> Array:
        """(N, 2) pixels of (N, 3) points in base; NaN behind the camera."""
        local = apply(inverse(look_at(self.eye, self.target)), points.astype(float))
        focal = self.size[1] / 2 / np.tan(np.radians(FOV_DEG) / 2)
        depth = np.where(local[:, 2] > 1e-6, local[:, 2], np.nan)[:, None]
        middle = (np.array(self.size) - 1) / 2
        return np.asarray(local[:, :2] / depth * focal + middle)


@dataclass(frozen=True)
class Moment:
    """One picture of the strip.

    Attributes:
        state: The world then.
        title: What is happening.
        prediction: Flows to draw, or None.
        sample: Which of them.
        grasp: (3,) grasp point to mark, or None.
    """

    state: StateSample
    title: str
    prediction: PredictionSample | None = None
    sample: int = 0
    grasp: Array | None = None


def moments(record: RunRecord, most: int = 8) -> list[Moment]:
    """The decisive moments: first look, every grasp, steps, the end; at most `most`."""
    found: list[Moment] = []
    by_stamp = {round(p.stamp, 6): p for p in record.predictions}
    for decision in record.decisions:
        name, sample = decision.decision, decision.chosen_sample
        if sample < 0 or name not in ("approach", "step", "switch", "retreat"):
            continue
        prediction = by_stamp.get(round(decision.prediction_stamp, 6))
        state = _state_at(record, decision.time)
        title = f"{name} · step {decision.step} · open {state.open_ratio:.2f}"
        found.append(Moment(state, title, prediction, sample, np.array(decision.grasp_point)))
    end = record.states[-1]
    chosen = np.unique(np.linspace(0, max(len(found) - 1, 0), most - 1).round().astype(int))
    picked = [found[i] for i in chosen] if found else []
    return [*picked, Moment(end, f"{record.outcome} · open {end.open_ratio:.2f}")]


def _state_at(record: RunRecord, time: float) -> StateSample:
    earlier = [state for state in record.states if state.time <= time]
    return earlier[-1] if earlier else record.states[0]


def _picture(
    world: ArmWorld, state: StateSample, view: View, supersampling: int = 2
) -> NDArray[np.uint8]:
    world.set_object_positions(state.joints)
    world.set_arm_positions(state.arm)
    return render_rgb(
        world.parts(),
        world.part_poses(),
        view.eye,
        view.target,
        view.size,
        FOV_DEG,
        supersampling=supersampling,
    )


def picture_grid(
    count: int, columns: int, size: tuple[float, float]
) -> tuple[Figure, Sequence[Axes]]:
    """A figure with places for `count` pictures side by side, each of a size [inch]."""
    rows = -(-count // columns)
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(size[0] * columns, size[1] * rows),
        layout="constrained",
        squeeze=False,
    )
    for axis in axes.flat:
        axis.set_axis_off()
    return figure, list(axes.flat[:count])


def draw_strip(
    record: RunRecord, world: ArmWorld, view: View, path: Path, columns: int = 4
) -> None:
    """Write the strip: pictures from the report camera with the predicted flow as arrows."""
    shown = moments(record)
    size = (3.1, 3.1 * view.size[1] / view.size[0])
    figure, axes = picture_grid(len(shown), columns, size)
    for axis, moment in zip(axes, shown, strict=True):
        axis.imshow(_picture(world, moment.state, view))
        axis.set_title(moment.title, fontsize=8)
        if moment.prediction is not None:
            _draw_flow(axis, moment, view)
        axis.set(xlim=(0, view.size[0] - 1), ylim=(view.size[1] - 1, 0))
    figure.savefig(path, dpi=100)
    plt.close(figure)


def _draw_flow(axis: Axes, moment: Moment, view: View) -> None:
    prediction = moment.prediction
    if prediction is None:
        return
    flow = prediction.flows[moment.sample]
    moving = np.flatnonzero(np.linalg.norm(flow, axis=1) > 0.15)
    chosen = moving[:: max(1, len(moving) // 60)]
    tails = view.project(prediction.points[chosen])
    heads = view.project(prediction.points[chosen] + ARROW * flow[chosen])
    axis.quiver(
        *tails.T,
        *(heads - tails).T,
        angles="xy",
        scale_units="xy",
        scale=1,
        color="#1f9d55",
        width=0.004,
        alpha=0.75,
    )
    if moment.grasp is not None:
        nearest = int(np.argmin(np.linalg.norm(prediction.points - moment.grasp, axis=1)))
        ends = np.stack([moment.grasp, moment.grasp + 1.6 * ARROW * flow[nearest]])
        tail, head = view.project(ends)
        axis.annotate("", head, tail, arrowprops={"arrowstyle": "-|>", "color": "#c0392b", "lw": 2})


def write_animation(
    record: RunRecord, world: ArmWorld, view: View, path: Path, frames: int = 40
) -> None:
    """Write an animated GIF of the whole run, evenly spaced in simulated time."""
    times = np.linspace(record.states[0].time, record.states[-1].time, frames)
    pictures = [
        Image.fromarray(_picture(world, _state_at(record, float(time)), view, 1)) for time in times
    ]
    _save_gif(pictures, path)


def _save_gif(pictures: Sequence[Image.Image], path: Path) -> None:
    palette = [picture.quantize(96, dither=Image.Dither.NONE) for picture in pictures]
    palette[0].save(path, save_all=True, append_images=palette[1:], duration=110, loop=0)
