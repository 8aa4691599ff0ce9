"""End of an attempt: failure, release, retreat, another look, the end of the run."""

from __future__ import annotations

from flowbothd_common.motion import MotionGoal, MotionKind
from flowbothd_common.types import Outcome, SuctionPhase
from flowbothd_policy.commands import Finish, Observe
from flowbothd_policy.grasp_selection import Place
from flowbothd_policy.state import After, Choice, Phase, Turn


def observe(turn: Turn, reason: str, decision: str = "observe") -> None:
    """Look again, newer than now, with the arm where it is."""
    turn.set(
        phase=Phase.OBSERVING,
        observe_after=turn.now,
        observation=None,
        few_points=-1,
        trials=0,
        closest=None,
    )
    turn.do(Observe(turn.now))
    turn.say(decision, reason)


def approach(turn: Turn, choice: Choice, reason: str) -> None:
    """Go to the standoff of a grasp."""
    grasp = choice.grasp
    joint = (
        grasp.screw.joint if turn.params.send_joint_estimate and grasp.screw is not None else None
    )
    turn.set(choice=choice, away=True, attached=False)
    turn.move(
        MotionGoal(
            MotionKind.APPROACH, contact=grasp.point, direction=grasp.direction, joint=joint
        ),
        Phase.APPROACHING,
    )
    turn.say("approach", reason)


def may_contact(turn: Turn) -> bool:
    """Return True if another contact is within the allowed number."""
    return turn.state.grasps <= turn.params.max_recontacts


def fail(
    turn: Turn, reason: str, *, refuted: Place | None = None, avoid: Place | None = None
) -> None:
    """End the present attempt; the next one follows if any is left.

    Args:
        turn: The turn.
        reason: What went wrong.
        refuted: A pull that ought to have moved the part and did not.
        avoid: A place where the cup cannot hold or the arm cannot go.
    """
    if turn.params.reject_failed_directions:
        if refuted is not None:
            turn.set(refuted=(*turn.state.refuted, refuted))
        if avoid is not None:
            turn.set(avoided=(*turn.state.avoided, avoid))
    if may_contact(turn):
        turn.set(after_retreat=After.OBSERVE)
        let_go(turn, f"failed attempt: {reason}", "release")
        return
    outcome = Outcome.GAVE_UP if turn.state.held else Outcome.NO_CONTACT
    end(
        turn,
        outcome,
        f"{reason}; all {1 + turn.params.max_recontacts} contacts are used up",
    )


def end(turn: Turn, outcome: Outcome, reason: str) -> None:
    """Wind up: let the part go, bring the arm back, then finish."""
    turn.set(ending=(outcome, reason), after_retreat=After.FINISH)
    let_go(turn, f"{outcome.value}: {reason}", "end")


def let_go(turn: Turn, reason: str, decision: str) -> None:
    """Release the part if the pump is on, then go back to the start pose."""
    waiting = turn.state.pump_on and turn.state.suction is not SuctionPhase.OFF
    if turn.state.pump_on:
        turn.pump(0.0)
    turn.set(attached=False)
    if waiting:
        # The arm backs off only when the cup has vented: it would pull the part along.
        turn.set(phase=Phase.RELEASING)
        turn.say(decision, reason)
    else:
        retreat(turn, reason, decision)


def retreat(turn: Turn, reason: str, decision: str = "retreat") -> None:
    """Go back to the start pose, or straight to what follows if the arm is there."""
    if not turn.state.away:
        after_retreat(turn, reason, decision)
        return
    turn.move(MotionGoal(MotionKind.RETREAT), Phase.RETREATING)
    turn.say(decision, reason)


def after_retreat(turn: Turn, reason: str, decision: str = "observe") -> None:
    """Carry on from the start pose."""
    state = turn.state
    if state.ending is not None:
        finish(turn, *state.ending)
    elif state.after_retreat is After.APPROACH and state.choice is not None:
        turn.set(after_retreat=After.OBSERVE)
        approach(turn, state.choice, "to the new grasp point")
    else:
        observe(turn, reason, "observe" if decision == "retreat" else decision)


def finish(turn: Turn, outcome: Outcome, reason: str) -> None:
    """Finish at once, where the arm is."""
    turn.set(phase=Phase.FINISHED, ending=(outcome, reason), attached=False)
    turn.say("finish", reason)
    turn.do(Finish(outcome, reason))


def interrupted(turn: Turn, reason: str) -> None:
    """Carry on after a motion cut short by silent inputs or a held arm; no failed attempt."""
    count = turn.state.interruptions + 1
    turn.set(interruptions=count)
    if count > turn.params.max_interruptions and turn.state.ending is not None:
        # The last way home was cut short as well: nothing is gained by another.
        outcome, why = turn.state.ending
        finish(turn, outcome, f"{why}; {reason}")
    elif count > turn.params.max_interruptions:
        end(turn, Outcome.ABORTED, f"{reason}; interrupted {count} times")
    else:
        recover(turn, reason, "recover")


def recover(turn: Turn, reason: str, decision: str) -> None:
    """Take up the run again from wherever it was interrupted."""
    state = turn.state
    if state.ending is not None:
        let_go(turn, reason, decision)
    elif state.attached and state.suction is SuctionPhase.HOLDING:
        observe(turn, f"{reason}; the part is still held", decision)
    else:
        turn.set(after_retreat=After.OBSERVE)
        let_go(turn, reason, decision)
