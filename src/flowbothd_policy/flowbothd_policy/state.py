"""The policy's state between two events, and the turn that carries it over one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.motion import MotionGoal
from flowbothd_common.types import Array, Outcome, SuctionPhase
from flowbothd_policy.commands import Command, Decision, Move, SetSuction
from flowbothd_policy.events import CloudArrived
from flowbothd_policy.grasp_selection import Grasp, Place
from flowbothd_policy.history import Memory
from flowbothd_policy.opening import Opening, Travel, judge_opening
from flowbothd_policy.params import PolicyParams


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


class Turn:
    """One transition under construction: the state so far, and the commands in order.

    Attributes:
        state: As it will be after the event.
        params: The policy's parameters.
        event: Name of the event.
        now: Node clock [s].
        commands: What has been asked for so far.
        updated: Whether the history was updated by this event.
    """

    def __init__(self, state: PolicyState, params: PolicyParams, event: str, now: float) -> None:
        self.state = state
        self.params = params
        self.event = event
        self.now = now
        self.commands: list[Command] = []
        self.updated = False

    def set(self, **changes: Any) -> None:
        """Replace fields of the state."""
        self.state = replace(self.state, **changes)

    def do(self, command: Command) -> None:
        """Ask for something."""
        self.commands.append(command)

    def move(self, goal: MotionGoal, phase: Phase) -> None:
        """Ask for a motion and wait for its result in `phase`."""
        self.set(phase=phase, goal=goal, asking_again=False)
        self.do(Move(goal))

    def pump(self, vacuum: float) -> None:
        """Ask the pump for a vacuum [Pa]; 0 = release."""
        self.set(pump_on=vacuum > 0)
        self.do(SetSuction(vacuum))

    @property
    def opening(self) -> Opening:
        """Opening of the part, estimated from the path of the tool."""
        return judge_opening(self.state.travel, self.params.opening)

    def say(self, decision: str, reason: str, *, switched: bool = False) -> None:
        """Record what was decided; to be called once the state is as it will be."""
        state = self.state
        choice = state.choice
        ended = state.phase is Phase.FINISHED and state.ending is not None
        used = {}
        if choice is not None:
            used = {
                "prediction_stamp": choice.stamp,
                "chosen_sample": choice.sample,
                "grasp_point": choice.grasp.point,
                "flow": choice.grasp.flow,
            }
        record = Decision(
            sequence=state.sequence,
            time=self.now,
            state=state.phase.value,
            event=self.event,
            decision=decision,
            reason=reason,
            step=state.step,
            grasps=state.grasps,
            trials=state.trials,
            tool_motion=state.tool_motion,
            history_updated=self.updated,
            grasp_switched=switched,
            opening=self.opening.share,
            outcome=state.ending[0].value if ended and state.ending else "",
            **used,  # type: ignore[arg-type]
        )
        self.set(sequence=state.sequence + 1)
        self.do(record)
