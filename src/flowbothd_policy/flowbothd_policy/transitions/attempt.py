"""One attempt at the part: observation, approach, failure, release, retreat, end of the run."""

from __future__ import annotations

from flowbothd_common.motion import MotionGoal, MotionKind
from flowbothd_common.types import Outcome, SuctionPhase
from flowbothd_policy.commands import Finish
from flowbothd_policy.grasp_selection import Place
from flowbothd_policy.state import After, Choice, Phase
from flowbothd_policy.transitions.transition import Transition


def observe(transition: Transition, reason: str, decision: str = "observe") -> None:
    """Wait for a cloud that is newer than now, with the arm where it is."""
    transition.set(
        phase=Phase.OBSERVING,
        observe_after=transition.now,
        observation=None,
        few_points=-1,
        trials=0,
        closest=None,
    )
    transition.say(decision, reason)


def approach(transition: Transition, choice: Choice, reason: str) -> None:
    """Go to the standoff of a grasp."""
    grasp = choice.grasp
    joint = (
        grasp.screw.joint
        if transition.params.send_joint_estimate and grasp.screw is not None
        else None
    )
    transition.set(choice=choice, away=True, attached=False)
    transition.move(
        MotionGoal(
            MotionKind.APPROACH, contact=grasp.point, direction=grasp.direction, joint=joint
        ),
        Phase.APPROACHING,
    )
    transition.say("approach", reason)


def may_contact(transition: Transition) -> bool:
    """Return True if another contact is within the allowed number."""
    return transition.state.grasps <= transition.params.max_recontacts


def fail(
    transition: Transition, reason: str, *, refuted: Place | None = None, avoid: Place | None = None
) -> None:
    """End the present attempt; the next one follows if any is left.

    Args:
        transition: Under construction.
        reason: What went wrong.
        refuted: A pull that ought to have moved the part and did not.
        avoid: A place where the cup cannot hold or the arm cannot go.
    """
    if transition.params.reject_failed_directions:
        if refuted is not None:
            transition.set(refuted=(*transition.state.refuted, refuted))
        if avoid is not None:
            transition.set(avoided=(*transition.state.avoided, avoid))
    if may_contact(transition):
        transition.set(after_retreat=After.OBSERVE)
        let_go(transition, f"failed attempt: {reason}", "release")
        return
    outcome = Outcome.GAVE_UP if transition.state.held else Outcome.NO_CONTACT
    end(
        transition,
        outcome,
        f"{reason}; all {1 + transition.params.max_recontacts} contacts are used up",
    )


def end(transition: Transition, outcome: Outcome, reason: str) -> None:
    """Wind up: let the part go, bring the arm back, then finish."""
    transition.set(ending=(outcome, reason), after_retreat=After.FINISH)
    let_go(transition, f"{outcome.value}: {reason}", "end")


def let_go(transition: Transition, reason: str, decision: str) -> None:
    """Release the part if the pump is on, then go back to the start pose."""
    waiting = transition.state.pump_on and transition.state.suction is not SuctionPhase.OFF
    if transition.state.pump_on:
        transition.pump(0.0)
    transition.set(attached=False)
    if waiting:
        # The arm backs off only when the cup has vented: it would pull the part along.
        transition.set(phase=Phase.RELEASING)
        transition.say(decision, reason)
    else:
        retreat(transition, reason, decision)


def retreat(transition: Transition, reason: str, decision: str = "retreat") -> None:
    """Go back to the start pose, or straight to what follows if the arm is there."""
    if not transition.state.away:
        after_retreat(transition, reason, decision)
        return
    transition.move(MotionGoal(MotionKind.RETREAT), Phase.RETREATING)
    transition.say(decision, reason)


def after_retreat(transition: Transition, reason: str, decision: str = "observe") -> None:
    """Carry on from the start pose."""
    state = transition.state
    if state.ending is not None:
        finish(transition, *state.ending)
    elif state.after_retreat is After.APPROACH and state.choice is not None:
        transition.set(after_retreat=After.OBSERVE)
        approach(transition, state.choice, "to the new grasp point")
    else:
        observe(transition, reason, "observe" if decision == "retreat" else decision)


def finish(transition: Transition, outcome: Outcome, reason: str) -> None:
    """Finish at once, where the arm is."""
    transition.set(phase=Phase.FINISHED, ending=(outcome, reason), attached=False)
    transition.say("finish", reason)
    transition.do(Finish(outcome, reason))


def interrupted(transition: Transition, reason: str) -> None:
    """Carry on after a motion cut short by silent inputs or a held arm; no failed attempt."""
    count = transition.state.interruptions + 1
    transition.set(interruptions=count)
    if count > transition.params.max_interruptions and transition.state.ending is not None:
        # The last way home was cut short as well: nothing is gained by another.
        outcome, why = transition.state.ending
        finish(transition, outcome, f"{why}; {reason}")
    elif count > transition.params.max_interruptions:
        end(transition, Outcome.ABORTED, f"{reason}; interrupted {count} times")
    else:
        recover(transition, reason, "recover")


def recover(transition: Transition, reason: str, decision: str) -> None:
    """Take up the run again from wherever it was interrupted."""
    state = transition.state
    if state.ending is not None:
        let_go(transition, reason, decision)
    elif state.attached and state.suction is SuctionPhase.HOLDING:
        observe(transition, f"{reason}; the part is still held", decision)
    else:
        transition.set(after_retreat=After.OBSERVE)
        let_go(transition, reason, decision)
