"""Results of motions: the contact, the step, the way back, and what follows each."""

from __future__ import annotations

import numpy as np

from flowbothd_common.motion import MotionGoal, MotionKind, MotionReason, MotionResult
from flowbothd_common.transforms import angle_between
from flowbothd_common.types import Array, History, Outcome, SuctionPhase
from flowbothd_policy.grasp_selection import Place
from flowbothd_policy.history import part_motion, remember
from flowbothd_policy.state import Phase
from flowbothd_policy.transitions import attempt, selection
from flowbothd_policy.transitions.transition import Transition

_CUT_SHORT = (MotionReason.STALE_INPUT, MotionReason.TIMEOUT, MotionReason.LAGGING)
_STALLS = (MotionReason.STALLED, MotionReason.FORCE_LIMIT)
_CANNOT_GO = (
    MotionReason.UNREACHABLE,
    MotionReason.COLLISION,
    MotionReason.JOINT_LIMIT,
    MotionReason.SINGULARITY,
)
_EXPECTED = {
    Phase.APPROACHING: MotionKind.APPROACH,
    Phase.PROBING: MotionKind.PROBE,
    Phase.STEPPING: MotionKind.FLOW_STEP,
    Phase.RETREATING: MotionKind.RETREAT,
}
_MAX_RETREATS = 3
"""Retreats that may fail in a row; then the run ends where the arm is."""
_UNREACHABLE_PLACES = 3
"""Unreachable places with the same pull that refute the pull itself."""


def finished(transition: Transition, result: MotionResult) -> None:
    """Continue after a motion; the result of a motion that is not awaited is ignored."""
    if _EXPECTED.get(transition.state.phase) is not result.kind:
        return
    said = f"{result.kind.value} ended: {result.reason.value}"
    if result.message:
        said += f" ({result.message})"
    if result.reason is MotionReason.STOPPED:
        attempt.finish(transition, Outcome.ABORTED, f"{said}; stopped from outside the policy")
        return
    if result.reason is MotionReason.REJECTED:
        _refused(transition, said)
        return
    transition.set(tool=result.tool_end[:3, 3].astype(float), refusals=0)
    if result.kind is MotionKind.FLOW_STEP:
        after_step(transition, result, said)
    elif result.reason in _CUT_SHORT:
        attempt.interrupted(transition, said)
    elif result.kind is MotionKind.APPROACH:
        _after_approach(transition, result, said)
    elif result.kind is MotionKind.PROBE:
        _after_probe(transition, result, said)
    else:
        _after_retreat(transition, result, said)


def _refused(transition: Transition, said: str) -> None:
    """Ask again in a moment: the arm may still be settling from the motion before."""
    count = transition.state.refusals + 1
    transition.set(refusals=count)
    if count >= transition.params.max_refusals:
        attempt.finish(transition, Outcome.ERROR, f"{said}; refused {count} times")
    else:
        transition.set(asking_again=True)
        transition.say("wait", f"{said}; asking again")


def ask_again(transition: Transition) -> None:
    """Ask once more for the motion that was refused."""
    state = transition.state
    if state.goal is not None:
        transition.move(state.goal, state.phase)
        transition.say("retry", f"{state.goal.kind.value} once more")


def _place(transition: Transition, radius: float) -> Place | None:
    choice = transition.state.choice
    if choice is None:
        return None
    return Place(choice.grasp.point, choice.grasp.direction, radius)


def _after_approach(transition: Transition, result: MotionResult, said: str) -> None:
    choice = transition.state.choice
    if choice is None:
        return
    if result.reason is not MotionReason.REACHED and result.reached_fraction <= 1e-6:
        _unreachable(transition, said)
        return
    transition.set(grasps=transition.state.grasps + 1)
    if result.reason is not MotionReason.REACHED:
        attempt.fail(transition, said, avoid=_place(transition, transition.params.failed_radius))
        return
    # The tool points along its z axis; where it came from the near side (pushing from the front)
    # it has to travel along the flow to touch, otherwise against it.
    ahead = float(result.tool_end[:3, 2] @ choice.grasp.direction) > np.cos(np.pi / 4)
    direction = choice.grasp.direction if ahead else -choice.grasp.direction
    transition.set(travel=transition.state.travel.begun(), reach=float("inf"))
    transition.pump(transition.params.vacuum)
    transition.move(MotionGoal(MotionKind.PROBE, direction=direction), Phase.PROBING)
    transition.say("probe", f"{said}; pump on")


def _unreachable(transition: Transition, said: str) -> None:
    count = transition.state.unreachable + 1
    avoid = _place(transition, transition.params.failed_radius)
    if transition.params.reject_failed_directions and avoid is not None:
        # One or two unreachable places may be bad luck of the planner; after a third one in the
        # same direction the motion is held to be out of reach, not place after place along it.
        alike = [
            _alike(avoid, other, transition.params.failed_angle)
            for other in transition.state.avoided
        ]
        if sum(alike) >= _UNREACHABLE_PLACES - 1:
            transition.set(refuted=(*transition.state.refuted, avoid))
        transition.set(avoided=(*transition.state.avoided, avoid))
    transition.set(unreachable=count, away=False)
    if count >= transition.params.max_unreachable:
        attempt.end(transition, Outcome.GAVE_UP, f"{said}; {count} grasps could not be reached")
    else:
        attempt.observe(transition, said)


def _alike(a: Place, b: Place, angle: float) -> bool:
    return a.radius == b.radius and angle_between(a.direction, b.direction) < angle


def _after_probe(transition: Transition, result: MotionResult, said: str) -> None:
    choice = transition.state.choice
    if choice is None:
        return
    if result.vacuum or result.reason is MotionReason.VACUUM:
        transition.set(attached=True, held=True)
        if transition.state.first_axis is None:
            transition.set(first_axis=result.tool_end[:3, 2].astype(float))
        selection.step(transition, choice, said)
        return
    blocked = result.reason in _CANNOT_GO
    radius = transition.params.failed_radius if blocked else transition.params.grasp.avoid_radius
    attempt.fail(transition, said, avoid=_place(transition, radius))


def account(transition: Transition, result: MotionResult) -> tuple[Array, bool]:
    """Book a flow step: (part motion, whether the part moved)."""
    state, params = transition.state, transition.params
    motion = part_motion(result, params)
    # A part that springs back against the pull has not been opened; nothing is learnt from it.
    if float(motion @ state.pull) < 0:
        motion = np.zeros(3)
    moved = float(np.linalg.norm(motion)) > params.epsilon_m
    memory, travel = state.memory, state.travel
    if state.choice is not None and state.observation is not None:
        seen = History(state.observation.points, state.choice.flow)
        memory = remember(memory, motion, state.pull, seen, params)
        transition.updated = memory.updated
        screw = state.choice.grasp.screw
        start = result.tool_start[:3, 3].astype(float)
        if moved:
            travel = travel.extended(start, motion, screw, state.pull)
        elif result.reason in _STALLS:
            travel = travel.tried(start, state.pull)
    transition.set(step=state.step + 1, memory=memory, travel=travel, tool_motion=motion)
    if moved:
        transition.set(refuted=(), avoided=(), unreachable=0, reach=float("inf"), interruptions=0)
    return motion, moved


def after_step(transition: Transition, result: MotionResult, said: str) -> None:
    """Judge a flow step: opened, go on, or a failed attempt."""
    stayed = float(np.linalg.norm(result.tool_motion)) < transition.params.epsilon_m
    if result.reason in _CANNOT_GO and stayed:
        _blocked(transition, said)
        return
    motion, moved = account(transition, result)
    opening = transition.opening
    lost = result.reason is MotionReason.SUCTION_LOST or not result.vacuum
    said += f"; the part moved {100 * float(np.linalg.norm(motion)):.1f} cm"
    turned = _turned(transition, result)
    late = max(opening.share, turned) >= transition.params.opening.stall_fraction
    cannot_follow = not moved and result.reason in _CANNOT_GO
    no_use = result.reason is MotionReason.REACHED and not moved
    if late and (no_use or result.reason in _STALLS):
        transition.set(stalls=transition.state.stalls + 1)
    if opening.share >= 1:
        attempt.end(transition, Outcome.OPENED, f"{said}; {_in_words(transition)}, the target")
    elif transition.state.stalls >= transition.params.opening.stalls:
        reason = f"{said}; stalled {transition.state.stalls} times after {_in_words(transition)}"
        if turned > opening.share:
            reason += (
                f"; the surface has turned by {100 * turned:.0f} % of it since it was first held"
            )
        attempt.end(transition, Outcome.OPENED, reason)
    elif result.reason in _CUT_SHORT:
        attempt.interrupted(transition, said)
    elif transition.state.step >= transition.params.max_steps:
        reason = f"{said}; {transition.state.step} steps are used up after {_in_words(transition)}"
        attempt.end(transition, Outcome.NOT_OPENED, reason)
    elif lost:
        _came_off(transition, result, f"{said}; the part came off", moved)
    elif cannot_follow:
        # The arm is at its end, not the part: from another configuration it may go on.
        attempt.fail(transition, said)
    elif moved or late:
        attempt.observe(transition, f"{said}; {_in_words(transition)}")
    else:
        attempt.fail(transition, f"{said}, too little", refuted=_refuted(transition, result, moved))


def _turned(transition: Transition, result: MotionResult) -> float:
    """Transition of the held surface since the first contact, as a share of the target.

    A hinged part also moves while it is not held: it swings on after the cup has come off. The
    tool's axis is the normal of what it holds, on either side.
    """
    first = transition.state.first_axis
    if first is None or transition.params.opening.target_angle <= 0:
        return 0.0
    angle = angle_between(first, result.tool_end[:3, 2])
    return min(angle, np.pi - angle) / transition.params.opening.target_angle


def _came_off(transition: Transition, result: MotionResult, said: str, moved: bool) -> None:
    """A cup that came off says little of the direction: it may have peeled from a moving part.

    The place is kept off; only a second loss in the same direction counts against that direction.
    A part that holds still stops the arm by its force limit well before the cup gives way.
    """
    refuted = _refuted(transition, result, moved)
    avoid = None
    if refuted is not None:
        avoid = Place(refuted.point, refuted.direction, transition.params.grasp.avoid_radius)
        if not any(
            _alike(avoid, other, transition.params.failed_angle)
            for other in transition.state.avoided
        ):
            refuted = None
    attempt.fail(transition, said, refuted=refuted, avoid=avoid)


def _blocked(transition: Transition, said: str) -> None:
    """The arm cannot make the step at all: try half of it, then hold the part elsewhere."""
    state, params = transition.state, transition.params
    half = state.distance / 2
    held = state.suction is SuctionPhase.HOLDING
    if held and state.choice is not None and half > params.epsilon_m:
        transition.set(reach=half)
        selection.step(transition, state.choice, f"{said}; trying half of it")
    else:
        attempt.fail(transition, said, avoid=_place(transition, params.failed_radius))


def _refuted(transition: Transition, result: MotionResult, moved: bool) -> Place | None:
    """The pull just made, if it shows that the part does not move that way from there.

    It shows nothing if the part moved, nor if the part has moved that way before: then the step
    was stopped by the end of the joint, by friction or by a poor pull, not by a wrong direction.
    """
    direction = transition.state.memory.direction
    travelled = transition.state.travel.length > transition.params.epsilon_m
    known = (
        travelled
        and direction is not None
        and angle_between(transition.state.pull, direction) < transition.params.failed_angle
    )
    if moved or known:
        return None
    # Where the cup held, which is not where the newest prediction would grasp.
    start = result.tool_start[:3, 3].astype(float)
    return Place(start, transition.state.pull, transition.params.failed_radius)


def _in_words(transition: Transition) -> str:
    opening = transition.opening
    amount = (
        f"{100 * opening.amount:.1f} cm"
        if not np.isfinite(opening.radius)
        else f"{np.degrees(opening.amount):.0f} deg at {100 * opening.radius:.0f} cm from the hinge"
    )
    return f"opened by {amount} ({100 * opening.share:.0f} % of the target)"


def _after_retreat(transition: Transition, result: MotionResult, said: str) -> None:
    if result.reason is MotionReason.REACHED:
        transition.set(away=False, retreat_failures=0)
        attempt.after_retreat(transition, "back in the start pose")
        return
    count = transition.state.retreat_failures + 1
    transition.set(retreat_failures=count)
    if count < _MAX_RETREATS:
        attempt.retreat(transition, f"{said}; trying again")
        return
    ending = transition.state.ending or (Outcome.ERROR, said)
    reason = ending[1] if ending[1] == said else f"{ending[1]}; {said}"
    attempt.finish(transition, ending[0], f"{reason}; the arm did not get back to its start pose")
