"""Commands of the policy, and the record of its reasons."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from flowbothd_common.motion import MotionGoal
from flowbothd_common.types import Array, Cloud, History, Outcome


@dataclass(frozen=True)
class Predict:
    """Sample flow fields.

    Attributes:
        points: (N, 3) float32 cloud.
        stamp: Its stamp; the answer must carry it.
        history: What the network may remember, or None.
        samples: How many flow fields.
        seed: Determines the samples.
    """

    points: Cloud
    stamp: float
    history: History | None
    samples: int
    seed: int


@dataclass(frozen=True)
class Move:
    """Carry out a motion and report its result."""

    goal: MotionGoal


@dataclass(frozen=True)
class SetSuction:
    """Ask the pump for a vacuum [Pa]; 0 = release."""

    vacuum: float


@dataclass(frozen=True)
class StopMotion:
    """Bring the arm to rest; the running motion still reports a result."""


@dataclass(frozen=True)
class Finish:
    """The run is over."""

    outcome: Outcome
    reason: str


@dataclass(frozen=True)
class Decision:
    """One decision, as published on policy/decisions.

    Attributes:
        sequence: Counts from 0 within a run.
        time: When [s, node clock].
        state: Phase after the event.
        event: What arrived.
        decision: What was decided, one word.
        reason: For people.
        step: Flow steps executed so far.
        grasps: Contacts attempted so far.
        trials: Predictions rejected in this step.
        prediction_stamp: Stamp of the cloud behind the prediction that was used, 0 = none.
        chosen_sample: Row of the sample that was used, -1 = none.
        grasp_point: (3,) [m].
        flow: (3,) the flow acted upon, max-normalised.
        tool_motion: (3,) measured in the last step [m].
        history_updated: The last step was remembered.
        grasp_switched: This decision changes the grasp.
        opening: Opening judged from the tool's path, as a share of the target.
        outcome: Empty until the run has ended.
    """

    sequence: int
    time: float
    state: str
    event: str
    decision: str
    reason: str
    step: int
    grasps: int
    trials: int
    prediction_stamp: float = 0.0
    chosen_sample: int = -1
    grasp_point: Array = field(default_factory=lambda: np.zeros(3))
    flow: Array = field(default_factory=lambda: np.zeros(3))
    tool_motion: Array = field(default_factory=lambda: np.zeros(3))
    history_updated: bool = False
    grasp_switched: bool = False
    opening: float = 0.0
    outcome: str = ""


Command = Predict | Move | SetSuction | StopMotion | Finish | Decision
