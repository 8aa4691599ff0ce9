"""State of the policy between two events."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.motion import MotionGoal
from flowbothd_common.types import Array, Outcome, SuctionPhase
from flowbothd_policy.events import CloudArrived
from flowbothd_policy.grasp_selection import Grasp, Place
from flowbothd_policy.history import Memory
from flowbothd_policy.opening import Travel


class Phase(StrEnum):
    """Input that the policy is waiting for."""

    IDLE = "idle"
    OBSERVING = "observing"
    PREDICTING = "predicting"
    APPROACHING = "approaching"
    PROBING = "probing"
    STEPPING = "stepping"
    RELEASING = "releasing"
    RETREATING = "retreating"
    PAUSED = "paused"
    FINISHED = "finished"


class After(StrEnum):
    """Step that follows a retreat."""

    OBSERVE = "observe"
    APPROACH = "approach"
    FINISH = "finish"


@dataclass(frozen=True)
class Choice:
    """A sampled flow field and the grasp chosen from it.

    Attributes:
        grasp: Place and pull.
        flow: (N, 3) the whole field.
        sample: Its row in the answer.
        stamp: Stamp of the cloud behind it.
        penalty: How far it is from being accepted [rad]; 0 = accepted.
        complete: Whether the grasp was chosen with care; rejected samples are not worth it.
    """

    grasp: Grasp
    flow: NDArray[np.float32]
    sample: int
    stamp: float
    penalty: float = 0.0
    complete: bool = True


@dataclass(frozen=True)
class PolicyState:
    """Everything that the policy knows.

    Attributes:
        phase: What it waits for.
        suction: Last judged state of the suction cycle.
        pump_on: A vacuum has been asked for.
        attached: The part is held by the present grasp.
        away: The arm may be away from its start pose.
        sequence: Decisions so far.
        step: Flow steps executed.
        grasps: Contacts attempted.
        trials: Samples rejected in this step.
        observe_after: Clouds must be newer than this [s].
        observation: The cloud in use.
        choice: The prediction being acted upon.
        closest: Of the rejected samples of this step, the one closest to being accepted.
        tool: (3,) last known position of the suction tip [m].
        pull: (3,) direction of the step under way, unit.
        distance: Length asked of the step under way [m].
        reach: Longest step that the arm may be able to make from here [m].
        memory: Consistency direction and history.
        refuted: Places and pulls that did not move the part since something last moved.
        avoided: Places where the cup did not seal or the arm could not go, since then.
        travel: Paths of the tool while it held the part.
        stalls: Stalls late in the opening.
        held: The cup has held the part at least once.
        first_axis: (3,) tool axis when it did so first, the part closed; None before.
        unreachable: Grasps that the arm could not reach.
        prediction_failures: In a row.
        interruptions: Motions that missing inputs cut short.
        retreat_failures: In a row.
        few_points: Size of the last cloud that was too small.
        after_retreat: What follows the retreat.
        ending: Outcome and reason once the run is winding up.
        lost: What is missing while paused.
        goal: The last motion asked for.
        refusals: How often in a row it was refused.
        asking_again: It was refused and will be asked for again.
        halting: A stop of the arm has been requested and not yet confirmed.
        tool_motion: (3,) part motion measured in the last step [m].
    """

    phase: Phase = Phase.IDLE
    suction: SuctionPhase = SuctionPhase.OFF
    pump_on: bool = False
    attached: bool = False
    away: bool = False
    sequence: int = 0
    step: int = 0
    grasps: int = 0
    trials: int = 0
    observe_after: float = float("-inf")
    observation: CloudArrived | None = None
    choice: Choice | None = None
    closest: Choice | None = None
    tool: Array = field(default_factory=lambda: np.zeros(3))
    pull: Array = field(default_factory=lambda: np.zeros(3))
    distance: float = 0.0
    reach: float = float("inf")
    memory: Memory = field(default_factory=Memory)
    refuted: tuple[Place, ...] = ()
    avoided: tuple[Place, ...] = ()
    travel: Travel = field(default_factory=Travel)
    stalls: int = 0
    held: bool = False
    first_axis: Array | None = None
    unreachable: int = 0
    prediction_failures: int = 0
    interruptions: int = 0
    retreat_failures: int = 0
    few_points: int = -1
    after_retreat: After = After.OBSERVE
    ending: tuple[Outcome, str] | None = None
    lost: tuple[str, ...] = ()
    goal: MotionGoal | None = None
    refusals: int = 0
    asking_again: bool = False
    halting: bool = False
    tool_motion: Array = field(default_factory=lambda: np.zeros(3))
