"""Transitions of the policy after the result of a motion."""

from __future__ import annotations

import numpy as np

from flowbothd_common.motion import MotionGoal, MotionKind, MotionReason, MotionResult
from flowbothd_common.transforms import angle_between
from flowbothd_common.types import Array, History, Outcome, SuctionPhase
from flowbothd_policy import attempts, choosing
from flowbothd_policy.grasp_selection import Place
from flowbothd_policy.history import part_motion, remember
from flowbothd_policy.state import Phase, Turn

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
_UNREACHABLE_PLACES = 3


def finished(turn: Turn, result: MotionResult) -> None:
    """Go on after a motion; results of motions that are not awaited are ignored."""
    if _EXPECTED.get(turn.state.phase) is not result.kind:
        return
    said = f"{result.kind.value} ended: {result.reason.value}"
    if result.message:
        said += f" ({result.message})"
    if result.reason is MotionReason.STOPPED:
        attempts.finish(turn, Outcome.ABORTED, f"{said}; stopped from outside the policy")
        return
    if result.reason is MotionReason.REJECTED:
        _refused(turn, said)
        return
    turn.set(tool=result.tool_end[:3, 3].astype(float), refusals=0)
    if result.kind is MotionKind.FLOW_STEP:
        after_step(turn, result, said)
    elif result.reason in _CUT_SHORT:
        attempts.interrupted(turn, said)
    elif result.kind is MotionKind.APPROACH:
        _after_approach(turn, result, said)
    elif result.kind is MotionKind.PROBE:
        _after_probe(turn, result, said)
    else:
        _after_retreat(turn, result, said)


def _refused(turn: Turn, said: str) -> None:
    """Ask again in a moment: the arm may still be settling from the motion before."""
    count = turn.state.refusals + 1
    turn.set(refusals=count)
    if count >= turn.params.max_refusals:
        attempts.finish(turn, Outcome.ERROR, f"{said}; refused {count} times")
    else:
        turn.set(asking_again=True)
        turn.say("wait", f"{said}; asking again")


def ask_again(turn: Turn) -> None:
    """Ask once more for the motion that was refused."""
    state = turn.state
    if state.goal is not None:
        turn.move(state.goal, state.phase)
        turn.say("retry", f"{state.goal.kind.value} once more")


def _place(turn: Turn, radius: float) -> Place | None:
    choice = turn.state.choice
    if choice is None:
        return None
    return Place(choice.grasp.point, choice.grasp.direction, radius)


def _after_approach(turn: Turn, result: MotionResult, said: str) -> None:
    choice = turn.state.choice
    if choice is None:
        return
    if result.reason is not MotionReason.REACHED and result.reached_fraction <= 1e-6:
        _unreachable(turn, said)
        return
    turn.set(grasps=turn.state.grasps + 1)
    if result.reason is not MotionReason.REACHED:
        attempts.fail(turn, said, avoid=_place(turn, turn.params.failed_radius))
        return
    # The tool points along its z axis; where it came from the near side (pushing from the front)
    # it has to travel along the flow to touch, otherwise against it.
    ahead = float(result.tool_end[:3, 2] @ choice.grasp.direction) > np.cos(np.pi / 4)
    direction = choice.grasp.direction if ahead else -choice.grasp.direction
    turn.set(travel=turn.state.travel.begun(), reach=float("inf"))
    turn.pump(turn.params.vacuum)
    turn.move(MotionGoal(MotionKind.PROBE, direction=direction), Phase.PROBING)
    turn.say("probe", f"{said}; pump on")


def _unreachable(turn: Turn, said: str) -> None:
    count = turn.state.unreachable + 1
    avoid = _place(turn, turn.params.failed_radius)
    if turn.params.reject_failed_directions and avoid is not None:
        # One or two unreachable places may be bad luck of the planner; after a third one in the
        # same direction the motion is held to be out of reach, not place after place along it.
        alike = [_alike(avoid, other, turn.params.failed_angle) for other in turn.state.avoided]
        if sum(alike) >= _UNREACHABLE_PLACES - 1:
            turn.set(refuted=(*turn.state.refuted, avoid))
        turn.set(avoided=(*turn.state.avoided, avoid))
    turn.set(unreachable=count, away=False)
    if count >= turn.params.max_unreachable:
        attempts.end(turn, Outcome.GAVE_UP, f"{said}; {count} grasps could not be reached")
    else:
        attempts.observe(turn, said)


def _alike(a: Place, b: Place, angle: float) -> bool:
    return a.radius == b.radius and angle_between(a.direction, b.direction) < angle


def _after_probe(turn: Turn, result: MotionResult, said: str) -> None:
    choice = turn.state.choice
    if choice is None:
        return
    if result.vacuum or result.reason is MotionReason.VACUUM:
        turn.set(attached=True, held=True)
        if turn.state.first_axis is None:
            turn.set(first_axis=result.tool_end[:3, 2].astype(float))
        choosing.step(turn, choice, said)
        return
    blocked = result.reason in _CANNOT_GO
    radius = turn.params.failed_radius if blocked else turn.params.grasp.avoid_radius
    attempts.fail(turn, said, avoid=_place(turn, radius))


def account(turn: Turn, result: MotionResult) -> tuple[Array, bool]:
    """Book a flow step: (part motion, whether the part moved)."""
    state, params = turn.state, turn.params
    motion = part_motion(result, params)
    # A part that springs back against the pull has not been opened; nothing is learnt from it.
    if float(motion @ state.pull) < 0:
        motion = np.zeros(3)
    moved = float(np.linalg.norm(motion)) > params.epsilon_m
    memory, travel = state.memory, state.travel
    if state.choice is not None and state.observation is not None:
        seen = History(state.observation.points, state.choice.flow)
        memory = remember(memory, motion, state.pull, seen, params)
        turn.updated = memory.updated
        screw = state.choice.grasp.screw
        start = result.tool_start[:3, 3].astype(float)
        if moved:
            travel = travel.extended(start, motion, screw, state.pull)
        elif result.reason in _STALLS:
            travel = travel.tried(start, state.pull)
    turn.set(step=state.step + 1, memory=memory, travel=travel, tool_motion=motion)
    if moved:
        turn.set(refuted=(), avoided=(), unreachable=0, reach=float("inf"), interruptions=0)
    return motion, moved


def after_step(turn: Turn, result: MotionResult, said: str) -> None:
    """Judge a flow step: opened, go on, or a failed attempt."""
    stayed = float(np.linalg.norm(result.tool_motion)) < turn.params.epsilon_m
    if result.reason in _CANNOT_GO and stayed:
        _blocked(turn, said)
        return
    motion, moved = account(turn, result)
    opening = turn.opening
    lost = result.reason is MotionReason.SUCTION_LOST or not result.vacuum
    said += f"; the part moved {100 * float(np.linalg.norm(motion)):.1f} cm"
    turned = _turned(turn, result)
    late = max(opening.share, turned) >= turn.params.opening.stall_fraction
    cannot_follow = not moved and result.reason in _CANNOT_GO
    no_use = result.reason is MotionReason.REACHED and not moved
    if late and (no_use or result.reason in _STALLS):
        turn.set(stalls=turn.state.stalls + 1)
    if opening.share >= 1:
        attempts.end(turn, Outcome.OPENED, f"{said}; {_in_words(turn)}, the target")
    elif turn.state.stalls >= turn.params.opening.stalls:
        reason = f"{said}; stalled {turn.state.stalls} times after {_in_words(turn)}"
        if turned > opening.share:
            reason += (
                f"; the surface has turned by {100 * turned:.0f} % of it since it was first held"
            )
        attempts.end(turn, Outcome.OPENED, reason)
    elif result.reason in _CUT_SHORT:
        attempts.interrupted(turn, said)
    elif turn.state.step >= turn.params.max_steps:
        reason = f"{said}; {turn.state.step} steps are used up after {_in_words(turn)}"
        attempts.end(turn, Outcome.NOT_OPENED, reason)
    elif lost:
        _came_off(turn, result, f"{said}; the part came off", moved)
    elif cannot_follow:
        # The arm is at its end, not the part: from another configuration it may go on.
        attempts.fail(turn, said)
    elif moved or late:
        attempts.observe(turn, f"{said}; {_in_words(turn)}")
    else:
        attempts.fail(turn, f"{said}, too little", refuted=_refuted(turn, result, moved))


def _turned(turn: Turn, result: MotionResult) -> float:
    """Turn of the held surface since the first contact, as a share of the target.

    A hinged part also moves while it is not held: it swings on after the cup has come off. The
    tool's axis is the normal of what it holds, on either side.
    """
    first = turn.state.first_axis
    if first is None or turn.params.opening.target_angle <= 0:
        return 0.0
    angle = angle_between(first, result.tool_end[:3, 2])
    return min(angle, np.pi - angle) / turn.params.opening.target_angle


def _came_off(turn: Turn, result: MotionResult, said: str, moved: bool) -> None:
    """A cup that came off says little of the direction: it may have peeled from a moving part.

    The place is kept off; only a second loss in the same direction counts against that direction.
    A part that holds still stops the arm by its force limit well before the cup gives way.
    """
    refuted = _refuted(turn, result, moved)
    avoid = None
    if refuted is not None:
        avoid = Place(refuted.point, refuted.direction, turn.params.grasp.avoid_radius)
        if not any(_alike(avoid, other, turn.params.failed_angle) for other in turn.state.avoided):
            refuted = None
    attempts.fail(turn, said, refuted=refuted, avoid=avoid)


def _blocked(turn: Turn, said: str) -> None:
    """The arm cannot make the step at all: try half of it, then hold the part elsewhere."""
    state, params = turn.state, turn.params
    half = state.distance / 2
    held = state.suction is SuctionPhase.HOLDING
    if held and state.choice is not None and half > params.epsilon_m:
        turn.set(reach=half)
        choosing.step(turn, state.choice, f"{said}; trying half of it")
    else:
        attempts.fail(turn, said, avoid=_place(turn, params.failed_radius))


def _refuted(turn: Turn, result: MotionResult, moved: bool) -> Place | None:
    """The pull just made, if it shows that the part does not move that way from there.

    It shows nothing if the part moved, nor if the part has moved that way before: then the step
    was stopped by the end of the joint, by friction or by a poor pull, not by a wrong direction.
    """
    direction = turn.state.memory.direction
    travelled = turn.state.travel.length > turn.params.epsilon_m
    known = (
        travelled
        and direction is not None
        and angle_between(turn.state.pull, direction) < turn.params.failed_angle
    )
    if moved or known:
        return None
    # Where the cup held, which is not where the newest prediction would grasp.
    start = result.tool_start[:3, 3].astype(float)
    return Place(start, turn.state.pull, turn.params.failed_radius)


def _in_words(turn: Turn) -> str:
    opening = turn.opening
    amount = (
        f"{100 * opening.amount:.1f} cm"
        if not np.isfinite(opening.radius)
        else f"{np.degrees(opening.amount):.0f} deg at {100 * opening.radius:.0f} cm from the hinge"
    )
    return f"opened by {amount} ({100 * opening.share:.0f} % of the target)"


def _after_retreat(turn: Turn, result: MotionResult, said: str) -> None:
    if result.reason is MotionReason.REACHED:
        turn.set(away=False, retreat_failures=0)
        attempts.after_retreat(turn, "back in the start pose")
        return
    count = turn.state.retreat_failures + 1
    turn.set(retreat_failures=count)
    if count < _MAX_RETREATS:
        attempts.retreat(turn, f"{said}; trying again")
        return
    ending = turn.state.ending or (Outcome.ERROR, said)
    reason = ending[1] if ending[1] == said else f"{ending[1]}; {said}"
    attempts.finish(turn, ending[0], f"{reason}; the arm did not get back to its start pose")
