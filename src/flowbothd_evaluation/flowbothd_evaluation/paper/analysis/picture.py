"""Shaded pictures of objects with flow arrows on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.types import Array, Cloud
from flowbothd_evaluation.paper.analysis.setting import Setting
from flowbothd_evaluation.run_record.pictures import FOV_DEG, View
from flowbothd_model.data.articulated import ArticulatedObject
from sim_bridge.mesh import Mesh
from sim_bridge.render import render_rgb
from sim_bridge.scene import Part

_BODY = (0.80, 0.80, 0.78)
_MOVING = (0.86, 0.76, 0.60)
_SIZE = (320, 300)
_ARROWS = 45
_LEAST = 0.15  # of the largest flow; shorter arrows are clutter


def view_of(low: Array, high: Array, side: float = -0.5, height: float = 0.45) -> View:
    """A view of everything between the corners (3,), from the front (-x) and a little aside."""
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    direction = np.array([-1.0, side, height])
    eye = middle + 1.5 * size * direction / np.linalg.norm(direction)
    return View(tuple(eye.tolist()), tuple(middle.tolist()), _SIZE)


def render(parts: Sequence[Part], poses: Mapping[str, Array], view: View) -> NDArray[np.uint8]:
    """The picture, (height, width, 3) uint8."""
    return render_rgb(parts, poses, view.eye, view.target, view.size, FOV_DEG)


class Portrait:
    """One setting, drawn as often as wanted from one place.

    Args:
        setting: The object.
        ratios: Openings that must fit into the picture.
        side: Where it is seen from, in units of the distance to the front: positive = from +y.
    """

    def __init__(
        self, setting: Setting, ratios: Sequence[float] = (0.0,), side: float = -0.5
    ) -> None:
        self._setting = setting
        item = setting.item
        self._parts = [
            Part(str(link), (_link_mesh(setting, link),)) for link in range(len(item.joints))
        ]
        posed = np.concatenate([item.posed_vertices(setting.positions(r)) for r in ratios])
        low, high = posed.min(0).astype(float), posed.max(0).astype(float)
        self.view = view_of(low, high, side)
        self.arrow = 0.22 * float(np.linalg.norm(high - low))
        """Length of the longest arrow [m]."""
        self._taken: dict[float, NDArray[np.uint8]] = {}

    def draw(
        self, axis: Any, ratio: float, points: Cloud, flow: Cloud, colour: str, title: str = ""
    ) -> None:
        """The object open by `ratio` with (N, 3) `flow` at (N, 3) `points`, object frame."""
        show(axis, self._picture(ratio), title)
        draw_arrows(axis, self.view, points, flow, self.arrow, colour)

    def _picture(self, ratio: float) -> NDArray[np.uint8]:
        """The object open by `ratio`; every opening is rendered once."""
        if ratio not in self._taken:
            poses = self._setting.item.poses(self._setting.positions(ratio))
            named = {str(link): pose for link, pose in enumerate(poses)}
            self._taken[ratio] = render(self._parts, named, self.view)
        return self._taken[ratio]


def label_of(item: ArticulatedObject) -> str:
    """Category and name, once each."""
    named = item.category.lower() in item.name.lower()
    return item.name if named else f"{item.category} {item.name}"


def show(axis: Any, picture: NDArray[np.uint8], title: str = "") -> None:
    """A picture without axes."""
    axis.imshow(picture)
    axis.set_axis_off()
    axis.set_title(title, fontsize=9)
    axis.set(xlim=(0, picture.shape[1] - 1), ylim=(picture.shape[0] - 1, 0))


def draw_arrows(
    axis: Any, view: View, points: Cloud, flow: Cloud, length: float, colour: str
) -> None:
    """Arrows of (N, 3) `flow` from (N, 3) `points`; a largest flow of 1 is `length` [m] long."""
    moving = np.flatnonzero(np.linalg.norm(flow, axis=1) > _LEAST)
    chosen = moving[:: max(1, len(moving) // _ARROWS)]
    if not len(chosen):
        return
    tails = view.project(points[chosen])
    heads = view.project(points[chosen] + length * flow[chosen])
    axis.quiver(
        *tails.T,
        *(heads - tails).T,
        angles="xy",
        scale_units="xy",
        scale=1,
        color=colour,
        width=0.006,
        headwidth=4.5,
        alpha=0.85,
    )


def _link_mesh(setting: Setting, link: int) -> Mesh:
    """The triangles of one link; what moves is of another colour."""
    item = setting.item
    own = item.vertex_link == link
    faces = item.faces[own[item.faces[:, 0]]]
    number = np.cumsum(own) - 1
    joint = item.joints[link]
    moving = joint.movable or (joint.parent >= 0 and item.joints[joint.parent].movable)
    return Mesh(
        item.vertices[own].astype(float),
        number[faces].astype(np.int32),
        _MOVING if moving else _BODY,
    )
