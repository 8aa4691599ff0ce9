"""Opening of the part, estimated from the path of the tool while it held the part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flowbothd_common.transforms import angle_between, unit
from flowbothd_common.types import Array, JointEstimate, JointKind
from flowbothd_policy.params import OpeningParams
from flowbothd_policy.screw import Screw

_HINT_ERROR = 0.1
"""Relative error of a radius that a fitted screw suggests [-]."""
_MOVED_MEANWHILE = np.radians(15.0)
"""Difference between the turn of the pull and that of the path from which the part has moved while
it was not held [rad]."""


@dataclass(frozen=True)
class Segment:
    """The tool's path during one grasp.

    Attributes:
        points: K positions of the suction tip, each (3,) [m].
        screw: Rigid motion that the prediction behind its last step gave, if any.
        pull: (3,) unit direction of its first step.
    """

    points: tuple[Array, ...]
    screw: Screw | None = None
    pull: Array | None = None


@dataclass(frozen=True)
class Travel:
    """All paths of one run, in order; a new grasp begins a new segment."""

    segments: tuple[Segment, ...] = ()

    def begun(self) -> Travel:
        """Travel in which the next step begins a new segment."""
        return Travel((*self.segments, Segment(()))) if self.segments else Travel((Segment(()),))

    def tried(self, start: Array, pull: Array) -> Travel:
        """Travel whose present grasp was pulled without moving the part."""
        *before, last = self.segments or (Segment(()),)
        return self if last.points else Travel((*before, Segment((start,), None, pull)))

    def extended(
        self, start: Array, motion: Array, screw: Screw | None, pull: Array | None = None
    ) -> Travel:
        """Travel with one more step of the present grasp, made along `pull`."""
        *before, last = self.segments or (Segment(()),)
        points = last.points if last.points else (start,)
        # Steps of one grasp join: the tool's drift between them is not the part's motion.
        first = pull if last.pull is None else last.pull
        step = Segment((*points, points[-1] + motion), screw or last.screw, first)
        return Travel((*before, step))

    @property
    def length(self) -> float:
        """Sum of all steps [m]."""
        return sum(float(np.sum(_chords(segment))) for segment in self.segments)


@dataclass(frozen=True)
class Opening:
    """Opening of the part.

    Attributes:
        kind: Prismatic or revolute.
        amount: [m] or [rad].
        share: Of the target.
        radius: Distance of the present grasp from the axis [m]; infinite if prismatic.
    """

    kind: JointKind
    amount: float
    share: float
    radius: float

    def remaining(self) -> float:
        """Length of the tool's path [m] that is missing to the target."""
        if self.share <= 0:
            return float("inf")
        rest = self.amount / self.share - self.amount
        return rest if self.kind is JointKind.PRISMATIC else rest * self.radius


@dataclass(frozen=True)
class PathFit:
    """A circle through a path.

    Attributes:
        joint: Axis, turning the way the path was travelled.
        radius: [m].
        sagitta: Largest distance of the path from the chord between its ends [m].
    """

    joint: JointEstimate
    radius: float
    sagitta: float


def fit_path(points: tuple[Array, ...]) -> PathFit | None:
    """Fit a circle to at least three positions in order; None if they lie on one line."""
    if len(points) < 3:
        return None
    path = np.asarray(points, dtype=float)
    centre = path.mean(axis=0)
    basis = np.linalg.svd(path - centre, full_matrices=False)[2]
    plane = (path - centre) @ basis[:2].T
    chord = path[-1] - path[0]
    if float(np.linalg.norm(chord)) < 1e-9:
        return None
    along = unit(chord)
    offsets = (path - path[0]) - np.outer((path - path[0]) @ along, along)
    sagitta = float(np.max(np.linalg.norm(offsets, axis=1)))
    if sagitta < 1e-5:
        return None
    rows = np.column_stack([2 * plane, np.ones(len(plane))])
    x, y, c = np.linalg.lstsq(rows, np.sum(plane**2, axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(c + x * x + y * y, 0.0)))
    axis_point = centre + x * basis[0] + y * basis[1]
    middle = path[len(path) // 2]
    axis = unit(np.cross(basis[0], basis[1]))
    if float(np.cross(axis, middle - axis_point) @ chord) < 0:
        axis = -axis
    return PathFit(JointEstimate(JointKind.REVOLUTE, axis, axis_point), radius, sagitta)


def judge_opening(travel: Travel, params: OpeningParams) -> Opening:
    """Estimate how far the part is open.

    The path itself decides between the two kinds as soon as it bends by more than three times its
    noise; until then the rigid motion fitted to the prediction does, unless the straightness of
    the path contradicts it. The angle is summed over the steps' chords, so it needs the radius
    alone and adds up over several grasps, unless the pull shows that the part moved in between.
    """
    moved = [k for k, segment in enumerate(travel.segments) if len(segment.points) > 1]
    if not moved:
        return Opening(JointKind.PRISMATIC, 0.0, 0.0, float("inf"))
    first = travel.segments[moved[0]]
    radii = {k: _judge(travel.segments[k], params) for k in moved}
    known = [radius for radius, sure in radii.values() if sure]
    known = known or [radius for radius, _ in radii.values()]
    if not np.isfinite(known[-1]):
        amount = travel.length
        share = amount / params.target_distance if params.target_distance > 0 else np.inf
        return Opening(JointKind.PRISMATIC, amount, float(share), float("inf"))
    amount, present = 0.0, float(known[-1])
    for k, segment in enumerate(travel.segments[moved[0] :], moved[0]):
        radius = radii[k][0] if k in radii else float("inf")
        present = radius if np.isfinite(radius) else present
        amount = _opening_at_contact(first, segment, amount)
        ratios = np.minimum(_chords(segment) / (2 * max(present, 1e-3)), 1.0)
        amount += float(np.sum(2 * np.arcsin(ratios)))
    share = amount / params.target_angle if params.target_angle > 0 else np.inf
    return Opening(JointKind.REVOLUTE, amount, float(share), present)


def expected_joint(
    travel: Travel, screw: Screw | None, params: OpeningParams
) -> JointEstimate | None:
    """The motion to expect next: from the path once it bends clearly, else from the prediction."""
    if travel.segments:
        fit = fit_path(travel.segments[-1].points)
        if fit is not None and fit.sagitta > 5 * params.path_noise:
            return fit.joint
    return screw.joint if screw is not None else None


def _chords(segment: Segment) -> Array:
    if len(segment.points) < 2:
        return np.zeros(0)
    return np.asarray(np.linalg.norm(np.diff(np.asarray(segment.points), axis=0), axis=1))


def _opening_at_contact(first: Segment, segment: Segment, so_far: float) -> float:
    """Angle at which a hinged part was when a grasp began.

    The pull turns with the part, so it shows how far the part has moved since the first pull that
    moved it: a lid falls back when it is let go, a door swings on. Differences as small as the
    predictions' own error are ignored in favour of what was measured.
    """
    if segment is first or first.pull is None or segment.pull is None:
        return so_far
    turned = angle_between(first.pull, segment.pull)
    return turned if abs(turned - so_far) > _MOVED_MEANWHILE else so_far


def _judge(segment: Segment, params: OpeningParams) -> tuple[float, bool]:
    """Radius of a segment (infinite for a line) and whether the path itself shows it."""
    fit = fit_path(segment.points)
    hint = segment.screw.radius_at(segment.points[0]) if segment.screw and segment.points else None
    if fit is not None and fit.sagitta > 3 * params.path_noise:
        if hint is None or not np.isfinite(hint):
            return fit.radius, True
        path_error = params.path_noise / fit.sagitta
        if abs(hint - fit.radius) > 3 * fit.radius * float(np.hypot(path_error, _HINT_ERROR)):
            return fit.radius, True
        weights = np.array([1 / path_error**2, 1 / _HINT_ERROR**2])
        return float(np.average([fit.radius, hint], weights=weights)), True
    if hint is None or not np.isfinite(hint):
        return float("inf"), False
    span = float(np.linalg.norm(segment.points[-1] - segment.points[0]))
    straight = len(segment.points) > 2 and hint < 0.8 * span**2 / (24 * params.path_noise)
    return (float("inf"), True) if straight else (hint, False)
