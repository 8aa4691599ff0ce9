"""Value types that cross package borders: clouds with flow, joint estimates, suction, outcomes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import InvalidCloudError

Array = NDArray[np.float64]
"""Any float64 array; shapes are given in docstrings."""

Cloud = NDArray[np.float32]
"""Points or flows, (N, 3) float32."""


def as_cloud(points: object, name: str = "cloud", *, min_points: int = 1) -> Cloud:
    """Return `points` as a contiguous (N, 3) float32 array.

    Raises:
        InvalidCloudError: not (N, 3), fewer than `min_points` points, or not finite.
    """
    array = np.ascontiguousarray(points, dtype=np.float32)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidCloudError(
            f"{name} has the wrong shape", got=array.shape, allowed="(N, 3) float32"
        )
    if len(array) < min_points:
        raise InvalidCloudError(
            f"{name} has too few points", got=len(array), allowed=f"at least {min_points}"
        )
    bad = int(np.count_nonzero(~np.isfinite(array).all(axis=1)))
    if bad:
        raise InvalidCloudError(
            f"{name} has points that are not finite",
            got=f"{bad} of {len(array)}",
            hint="drop NaN and infinite points first",
        )
    return array


def max_normalised(flows: NDArray[np.floating]) -> NDArray[np.float32]:
    """Divide each of (S, N, 3) flow fields by its largest norm; a field of zeros stays zero."""
    norms = np.linalg.norm(flows, axis=-1)
    largest = norms.max(axis=-1, keepdims=True)[..., None] if norms.size else np.ones(1)
    return np.asarray(flows / np.where(largest > 1e-9, largest, 1.0), dtype=np.float32)


@dataclass(frozen=True)
class History:
    """The last observation and prediction that moved the part.

    Attributes:
        points: (M, 3) float32, base frame [m].
        flow: (M, 3) float32, max-normalised.

    Raises:
        InvalidCloudError: shapes differ, or values are not finite.
    """

    points: Cloud
    flow: Cloud

    def __post_init__(self) -> None:
        """Validate and freeze both arrays as (M, 3) float32."""
        points = as_cloud(self.points, "history points")
        flow = as_cloud(self.flow, "history flow")
        if points.shape != flow.shape:
            raise InvalidCloudError(
                "history points and flow differ in number", got=(len(points), len(flow))
            )
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "flow", flow)


class Outcome(StrEnum):
    """Outcome of a run; one vocabulary for policy, demo and evaluation."""

    OPENED = "opened"
    NOT_OPENED = "not_opened"
    NO_CONTACT = "no_contact"
    NOT_VISIBLE = "not_visible"
    GAVE_UP = "gave_up"
    ABORTED = "aborted"
    UNOPENABLE_WITH_GROUND_TRUTH = "unopenable_with_ground_truth"
    ERROR = "error"


class JointKind(StrEnum):
    """Kind of joint that a part is thought to move on."""

    PRISMATIC = "prismatic"
    REVOLUTE = "revolute"


@dataclass(frozen=True)
class JointEstimate:
    """Estimated motion of a part: a translation along an axis, or a rotation about one.

    Attributes:
        kind: Prismatic or revolute.
        axis: (3,) unit vector: direction of travel, or rotation axis (right-hand rule).
        point: (3,) a point on the rotation axis [m]; zero and unused if prismatic.
    """

    kind: JointKind
    axis: Array
    point: Array


class SuctionPhase(StrEnum):
    """State of one suction cycle."""

    OFF = "off"
    BUILDING = "building"
    HOLDING = "holding"
    LOST = "lost"
    FAULT = "fault"


@dataclass(frozen=True)
class SuctionReading:
    """Measurement of the pump.

    Attributes:
        vacuum: Vacuum below ambient, >= 0 [Pa].
        part_present: A part seals the cup.
        part_detached: A part was held in this cycle and has come off.
        fault: Empty, or what is wrong with the pump.
        in_control_range: The vacuum is within the set-point's band.
    """

    vacuum: float = 0.0
    part_present: bool = False
    part_detached: bool = False
    fault: str = ""
    in_control_range: bool = False
