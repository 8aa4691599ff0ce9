"""Events of the policy; arrays are in the base frame, times on the node clock [s]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.motion import MotionResult
from flowbothd_common.types import Cloud, SuctionPhase


@dataclass(frozen=True)
class Start:
    """A run begins; the object is in view and closed."""


@dataclass(frozen=True)
class CloudArrived:
    """The object was seen.

    Attributes:
        points: (N, 3) float32, finite; N may be 0.
        stamp: When the image was taken.
    """

    points: Cloud
    stamp: float


@dataclass(frozen=True)
class PredictionArrived:
    """Flow fields were sampled.

    Attributes:
        points: (N, 3) float32 the cloud they belong to.
        flows: (S, N, 3) float32, max-normalised.
        stamp: Stamp of that cloud.
        model_id: Who predicted.
        seed: Of the request.
    """

    points: Cloud
    flows: NDArray[np.float32]
    stamp: float
    model_id: str = ""
    seed: int = 0


@dataclass(frozen=True)
class PredictionFailed:
    """The predictor answered that it could not."""

    message: str


@dataclass(frozen=True)
class MotionFinished:
    """A motion ended, for whatever reason."""

    result: MotionResult


@dataclass(frozen=True)
class SuctionChanged:
    """The judged state of the suction cycle changed."""

    phase: SuctionPhase
    message: str = ""


@dataclass(frozen=True)
class InputsLost:
    """Nodes or topics that the policy relies on went missing."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class InputsBack:
    """Everything that went missing is there again."""


@dataclass(frozen=True)
class WaitExpired:
    """The input named by `state_machine.waiting` did not arrive in time."""


@dataclass(frozen=True)
class OperatorStop:
    """Somebody outside ends the run.

    Attributes:
        reason: Why, for people.
        opened: Whether the part is open; None = judge by how far the tool has moved it.
    """

    reason: str
    opened: bool | None = None


Event = (
    Start
    | CloudArrived
    | PredictionArrived
    | PredictionFailed
    | MotionFinished
    | SuctionChanged
    | InputsLost
    | InputsBack
    | WaitExpired
    | OperatorStop
)

NAMES: dict[type, str] = {
    Start: "start",
    CloudArrived: "cloud",
    PredictionArrived: "prediction",
    PredictionFailed: "prediction_failed",
    MotionFinished: "motion_result",
    SuctionChanged: "suction",
    InputsLost: "inputs_lost",
    InputsBack: "inputs_back",
    WaitExpired: "wait_expired",
    OperatorStop: "operator_stop",
}
"""Words for events in decisions."""
