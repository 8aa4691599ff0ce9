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
from flowbothd_policy import attempts, choosing, motions
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
from flowbothd_policy.state import Phase, PolicyState, Turn

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
    turn = Turn(state, params, NAMES[type(event)], now)
    _HANDLERS[type(event)](turn, event)
    return turn.state, tuple(turn.commands)


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


def _on_start(turn: Turn, event: Start) -> None:
    if turn.state.phase not in _AT_REST:
        return
    turn.state = PolicyState(suction=turn.state.suction)
    if turn.params.retreat_first:
        turn.set(away=True)
        attempts.retreat(turn, "the run begins; to the start pose first")
    else:
        attempts.observe(turn, "the run begins")


def _on_cloud(turn: Turn, event: CloudArrived) -> None:
    state = turn.state
    if state.phase is not Phase.OBSERVING or event.stamp <= state.observe_after:
        return
    count = len(event.points)
    if count < turn.params.min_points:
        if state.few_points < 0:
            turn.set(few_points=count)
            turn.say("wait", f"only {count} points of the object are visible")
        turn.set(few_points=count)
        return
    choosing.ask(turn, event, f"{count} points of the object are visible")


def _on_prediction(turn: Turn, event: PredictionArrived) -> None:
    observation = turn.state.observation
    if turn.state.phase is not Phase.PREDICTING or observation is None:
        return
    if event.stamp != observation.stamp:
        return
    turn.set(prediction_failures=0)
    choosing.choose(turn, event, observation)


def _on_prediction_failed(turn: Turn, event: PredictionFailed) -> None:
    state = turn.state
    if state.phase is not Phase.PREDICTING or state.observation is None:
        return
    count = state.prediction_failures + 1
    turn.set(prediction_failures=count)
    if count >= turn.params.max_prediction_failures:
        reason = f"prediction failed {count} times: {event.message}"
        attempts.end(turn, Outcome.ERROR, reason)
    else:
        attempts.observe(turn, f"prediction failed: {event.message}")


def _on_motion(turn: Turn, event: MotionFinished) -> None:
    result = event.result
    if turn.state.phase is not Phase.PAUSED:
        motions.finished(turn, result)
        return
    # The motion that the pause stopped: what it moved counts, how it ended does not.
    turn.set(tool=result.tool_end[:3, 3].astype(float), halting=False)
    if result.kind is MotionKind.FLOW_STEP:
        motions.account(turn, result)
    elif result.kind is MotionKind.PROBE and result.vacuum:
        turn.set(attached=True, held=True)
    elif result.kind is MotionKind.RETREAT and result.reason is MotionReason.REACHED:
        turn.set(away=False)
    if not turn.state.lost:
        attempts.recover(turn, "everything is back and the arm at rest", "resume")


def _on_suction(turn: Turn, event: SuctionChanged) -> None:
    turn.set(suction=event.phase)
    state = turn.state
    if state.phase is Phase.RELEASING and event.phase is SuctionPhase.OFF:
        attempts.retreat(turn, "the cup has let go")
    elif event.phase is SuctionPhase.FAULT and state.phase not in (*_AT_REST, Phase.PAUSED):
        _stop_if_moving(turn)
        attempts.finish(turn, Outcome.ERROR, f"pump fault: {event.message or 'no further detail'}")
    elif (
        state.attached
        and event.phase is not SuctionPhase.HOLDING
        and state.phase in (Phase.OBSERVING, Phase.PREDICTING)
    ):
        attempts.fail(turn, "the part came off between two steps")


def _on_inputs_lost(turn: Turn, event: InputsLost) -> None:
    state = turn.state
    if state.phase in _AT_REST:
        return
    names = ", ".join(event.names)
    if state.phase in MOVING and not state.asking_again:
        turn.set(halting=True)
    turn.set(asking_again=False)
    _stop_if_moving(turn)
    if turn.params.on_inputs_lost == "abort":
        attempts.finish(turn, Outcome.ABORTED, f"missing: {names}")
        return
    turn.set(phase=Phase.PAUSED, lost=event.names)
    turn.say("pause", f"missing: {names}")


def _on_inputs_back(turn: Turn, event: InputsBack) -> None:
    if turn.state.phase is not Phase.PAUSED:
        return
    names = ", ".join(turn.state.lost)
    turn.set(lost=())
    if turn.state.halting:
        # Another motion would be refused while the last one still comes to rest.
        turn.say("wait", f"back again: {names}; waiting for the arm to come to rest")
    else:
        attempts.recover(turn, f"back again: {names}", "resume")


def _on_operator_stop(turn: Turn, event: OperatorStop) -> None:
    state = turn.state
    if state.phase in _AT_REST:
        return
    _stop_if_moving(turn)
    if state.pump_on:
        turn.pump(0.0)
    if state.ending is not None:
        attempts.finish(turn, *state.ending)
        return
    enough = turn.opening.share >= turn.params.opening.stall_fraction
    opened = enough if event.opened is None else event.opened
    outcome = Outcome.OPENED if opened else Outcome.ABORTED
    attempts.finish(turn, outcome, f"stopped from outside: {event.reason}")


def _on_wait_expired(turn: Turn, event: WaitExpired) -> None:
    state, params = turn.state, turn.params
    wait = waiting(state, params)
    if wait is None:
        return
    late = f"waited {wait[1]:g} s for {wait[0]}"
    if state.asking_again:
        motions.ask_again(turn)
    elif state.phase is Phase.OBSERVING:
        _not_seen(turn, late)
    elif state.phase is Phase.PREDICTING:
        _on_prediction_failed(turn, PredictionFailed(late))
    elif state.phase is Phase.RELEASING:
        attempts.retreat(turn, f"{late}; going on without")
    elif state.phase is Phase.PAUSED and not state.lost:
        # A motion node that was restarted knows nothing of the motion that it should end.
        turn.set(halting=False)
        attempts.recover(turn, f"{late}; going on", "resume")
    elif state.phase is Phase.PAUSED:
        if state.pump_on:
            turn.pump(0.0)
        attempts.finish(turn, Outcome.ABORTED, late)
    else:
        turn.do(StopMotion())
        if state.pump_on:
            turn.pump(0.0)
        attempts.finish(turn, Outcome.ERROR, late)


def _not_seen(turn: Turn, late: str) -> None:
    state = turn.state
    reason = late
    if state.few_points >= 0:
        reason += (
            f"; the last one had {state.few_points} points, of {turn.params.min_points} needed"
        )
    if state.attached:
        attempts.fail(turn, f"{reason}, while the part was held")
    else:
        attempts.end(turn, Outcome.NOT_VISIBLE, reason)


def _stop_if_moving(turn: Turn) -> None:
    if turn.state.phase in MOVING:
        turn.do(StopMotion())


_HANDLERS: dict[type, Callable[[Turn, Any], None]] = {
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
