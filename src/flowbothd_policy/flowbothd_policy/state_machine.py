"""The policy: a pure function from state, event and time to a new state and commands.

It has neither clock nor randomness; the same events give the same decisions, whether
they come from nodes, from a stepped simulation or from a bag. The caller carries out the
commands and feeds back what happens, in order. `waiting` says what a state waits for and how
long; when that time has passed on the steady clock, the driver sends `WaitExpired`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flowbothd_common.motion import MotionKind, MotionReason
from flowbothd_common.types import Outcome, SuctionPhase
from flowbothd_policy.commands import Command, StopMotion
from flowbothd_policy.events import (
    NAMES,
    CloudArrived,
    Event,
    InputsBack,
    InputsLost,
    MotionFinished,
    OperatorStop,
    PredictionArrived,
    PredictionFailed,
    Start,
    SuctionChanged,
    WaitExpired,
)
from flowbothd_policy.params import PolicyParams
from flowbothd_policy.state import Phase, PolicyState
from flowbothd_policy.transitions import attempt, motion_result, selection
from flowbothd_policy.transitions.transition import Transition

MOVING = (Phase.APPROACHING, Phase.PROBING, Phase.STEPPING, Phase.RETREATING)
"""Phases in which the arm moves."""

_AT_REST = (Phase.IDLE, Phase.FINISHED)


def advance(
    state: PolicyState, event: Event, now: float, params: PolicyParams
) -> tuple[PolicyState, tuple[Command, ...]]:
    """Carry the policy over one event.

    Events that mean nothing in the present state leave it as it is and ask for nothing.

    Args:
        state: As returned before; `PolicyState()` at first.
        event: What happened.
        now: Node clock [s].
        params: The same throughout a run.

    Returns:
        The new state, and the commands to carry out in order, decisions among them.
    """
    transition = Transition(state, params, NAMES[type(event)], now)
    _HANDLERS[type(event)](transition, event)
    return transition.state, tuple(transition.commands)


def waiting(state: PolicyState, params: PolicyParams) -> tuple[str, float] | None:
    """Return the awaited input in words and its timeout [s]; None if nothing is awaited."""
    if state.asking_again:
        return "the arm to be ready for the next motion", params.wait.refusal
    if state.phase in MOVING:
        return f"the end of the motion ({state.phase.value})", params.wait.motion
    if state.phase is Phase.PAUSED and not state.lost:
        return "the arm to come to rest", params.wait.halt
    return {
        Phase.OBSERVING: ("an object cloud", params.wait.observation),
        Phase.PREDICTING: ("a flow prediction", params.wait.prediction),
        Phase.RELEASING: ("the pump to vent", params.wait.release),
        Phase.PAUSED: (f"{', '.join(state.lost)} to come back", params.wait.pause),
    }.get(state.phase)


def _on_start(transition: Transition, event: Start) -> None:
    if transition.state.phase not in _AT_REST:
        return
    transition.state = PolicyState(suction=transition.state.suction)
    if transition.params.retreat_first:
        transition.set(away=True)
        attempt.retreat(transition, "the run begins; to the start pose first")
    else:
        attempt.observe(transition, "the run begins")


def _on_cloud(transition: Transition, event: CloudArrived) -> None:
    state = transition.state
    if state.phase is not Phase.OBSERVING or event.stamp <= state.observe_after:
        return
    count = len(event.points)
    if count < transition.params.min_points:
        if state.few_points < 0:
            transition.set(few_points=count)
            transition.say("wait", f"only {count} points of the object are visible")
        transition.set(few_points=count)
        return
    selection.ask(transition, event, f"{count} points of the object are visible")


def _on_prediction(transition: Transition, event: PredictionArrived) -> None:
    observation = transition.state.observation
    if transition.state.phase is not Phase.PREDICTING or observation is None:
        return
    if event.stamp != observation.stamp:
        return
    transition.set(prediction_failures=0)
    selection.choose(transition, event, observation)


def _on_prediction_failed(transition: Transition, event: PredictionFailed) -> None:
    state = transition.state
    if state.phase is not Phase.PREDICTING or state.observation is None:
        return
    count = state.prediction_failures + 1
    transition.set(prediction_failures=count)
    if count >= transition.params.max_prediction_failures:
        reason = f"prediction failed {count} times: {event.message}"
        attempt.end(transition, Outcome.ERROR, reason)
    else:
        attempt.observe(transition, f"prediction failed: {event.message}")


def _on_motion(transition: Transition, event: MotionFinished) -> None:
    result = event.result
    if transition.state.phase is not Phase.PAUSED:
        motion_result.finished(transition, result)
        return
    # The motion that the pause stopped: what it moved counts, how it ended does not.
    transition.set(tool=result.tool_end[:3, 3].astype(float), halting=False)
    if result.kind is MotionKind.FLOW_STEP:
        motion_result.account(transition, result)
    elif result.kind is MotionKind.PROBE and result.vacuum:
        transition.set(attached=True, held=True)
    elif result.kind is MotionKind.RETREAT and result.reason is MotionReason.REACHED:
        transition.set(away=False)
    if not transition.state.lost:
        attempt.recover(transition, "everything is back and the arm at rest", "resume")


def _on_suction(transition: Transition, event: SuctionChanged) -> None:
    transition.set(suction=event.phase)
    state = transition.state
    if state.phase is Phase.RELEASING and event.phase is SuctionPhase.OFF:
        attempt.retreat(transition, "the cup has let go")
    elif event.phase is SuctionPhase.FAULT and state.phase not in (*_AT_REST, Phase.PAUSED):
        _stop_if_moving(transition)
        attempt.finish(
            transition, Outcome.ERROR, f"pump fault: {event.message or 'no further detail'}"
        )
    elif (
        state.attached
        and event.phase is not SuctionPhase.HOLDING
        and state.phase in (Phase.OBSERVING, Phase.PREDICTING)
    ):
        attempt.fail(transition, "the part came off between two steps")


def _on_inputs_lost(transition: Transition, event: InputsLost) -> None:
    state = transition.state
    if state.phase in _AT_REST:
        return
    names = ", ".join(event.names)
    if state.phase in MOVING and not state.asking_again:
        transition.set(halting=True)
    transition.set(asking_again=False)
    _stop_if_moving(transition)
    if transition.params.on_inputs_lost == "abort":
        attempt.finish(transition, Outcome.ABORTED, f"missing: {names}")
        return
    transition.set(phase=Phase.PAUSED, lost=event.names)
    transition.say("pause", f"missing: {names}")


def _on_inputs_back(transition: Transition, event: InputsBack) -> None:
    if transition.state.phase is not Phase.PAUSED:
        return
    names = ", ".join(transition.state.lost)
    transition.set(lost=())
    if transition.state.halting:
        # Another motion would be refused while the last one still comes to rest.
        transition.say("wait", f"back again: {names}; waiting for the arm to come to rest")
    else:
        attempt.recover(transition, f"back again: {names}", "resume")


def _on_operator_stop(transition: Transition, event: OperatorStop) -> None:
    state = transition.state
    if state.phase in _AT_REST:
        return
    _stop_if_moving(transition)
    if state.pump_on:
        transition.pump(0.0)
    if state.ending is not None:
        attempt.finish(transition, *state.ending)
        return
    enough = transition.opening.share >= transition.params.opening.stall_fraction
    opened = enough if event.opened is None else event.opened
    outcome = Outcome.OPENED if opened else Outcome.ABORTED
    attempt.finish(transition, outcome, f"stopped from outside: {event.reason}")


def _on_wait_expired(transition: Transition, event: WaitExpired) -> None:
    state, params = transition.state, transition.params
    wait = waiting(state, params)
    if wait is None:
        return
    late = f"waited {wait[1]:g} s for {wait[0]}"
    if state.asking_again:
        motion_result.ask_again(transition)
    elif state.phase is Phase.OBSERVING:
        _not_seen(transition, late)
    elif state.phase is Phase.PREDICTING:
        _on_prediction_failed(transition, PredictionFailed(late))
    elif state.phase is Phase.RELEASING:
        attempt.retreat(transition, f"{late}; going on without")
    elif state.phase is Phase.PAUSED and not state.lost:
        # A motion node that was restarted knows nothing of the motion that it should end.
        transition.set(halting=False)
        attempt.recover(transition, f"{late}; going on", "resume")
    elif state.phase is Phase.PAUSED:
        if state.pump_on:
            transition.pump(0.0)
        attempt.finish(transition, Outcome.ABORTED, late)
    else:
        transition.do(StopMotion())
        if state.pump_on:
            transition.pump(0.0)
        attempt.finish(transition, Outcome.ERROR, late)


def _not_seen(transition: Transition, late: str) -> None:
    state = transition.state
    reason = late
    if state.few_points >= 0:
        needed = transition.params.min_points
        reason += f"; the last one had {state.few_points} points, of {needed} needed"
    if state.attached:
        attempt.fail(transition, f"{reason}, while the part was held")
    else:
        attempt.end(transition, Outcome.NOT_VISIBLE, reason)


def _stop_if_moving(transition: Transition) -> None:
    if transition.state.phase in MOVING:
        transition.do(StopMotion())


_HANDLERS: dict[type, Callable[[Transition, Any], None]] = {
    Start: _on_start,
    CloudArrived: _on_cloud,
    PredictionArrived: _on_prediction,
    PredictionFailed: _on_prediction_failed,
    MotionFinished: _on_motion,
    SuctionChanged: _on_suction,
    InputsLost: _on_inputs_lost,
    InputsBack: _on_inputs_back,
    WaitExpired: _on_wait_expired,
    OperatorStop: _on_operator_stop,
}
