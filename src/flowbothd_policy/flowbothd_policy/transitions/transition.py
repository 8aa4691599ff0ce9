"""One transition of the policy under construction: the new state, and the commands in order."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from flowbothd_common.motion import MotionGoal
from flowbothd_policy.commands import Command, Decision, Move, SetSuction
from flowbothd_policy.opening import Opening, judge_opening
from flowbothd_policy.params import PolicyParams
from flowbothd_policy.state import Phase, PolicyState


class Transition:
    """Accumulate the changes and commands that one event leads to.

    Attributes:
        state: State after the event, as far as it is decided.
        params: The policy's parameters.
        event: Name of the event.
        now: Node clock [s].
        commands: Commands so far.
        updated: True if this event updated the history.
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
        """Append a command."""
        self.commands.append(command)

    def move(self, goal: MotionGoal, phase: Phase) -> None:
        """Command a motion and wait for its result in `phase`."""
        self.set(phase=phase, goal=goal, asking_again=False)
        self.do(Move(goal))

    def pump(self, vacuum: float) -> None:
        """Command a vacuum [Pa]; 0 = release."""
        self.set(pump_on=vacuum > 0)
        self.do(SetSuction(vacuum))

    @property
    def opening(self) -> Opening:
        """Opening of the part, estimated from the path of the tool."""
        return judge_opening(self.state.travel, self.params.opening)

    def say(self, decision: str, reason: str, *, switched: bool = False) -> None:
        """Append the decision to the commands; to be called once the state is final."""
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
