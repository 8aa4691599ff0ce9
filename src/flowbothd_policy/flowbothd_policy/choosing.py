"""From sampled flow fields to one that is acted upon: consistency check, rejection, switching."""

from __future__ import annotations

import numpy as np

from flowbothd_common.motion import MotionGoal, MotionKind
from flowbothd_common.transforms import angle_between, unit
from flowbothd_common.types import Outcome
from flowbothd_policy import attempts
from flowbothd_policy.assessing import assess, completed
from flowbothd_policy.commands import Predict
from flowbothd_policy.events import CloudArrived, PredictionArrived
from flowbothd_policy.opening import expected_joint
from flowbothd_policy.state import After, Choice, Phase, Turn

_LAST_STEP_PLAY = 0.01


def sample_seed(run_seed: int, step: int, grasps: int, trial: int) -> int:
    """Seed of one request: the same run, step, contact and trial give the same samples."""
    entropy = np.random.SeedSequence((run_seed, step, grasps, trial))
    return int(entropy.generate_state(1, np.uint64)[0])


def ask(turn: Turn, observation: CloudArrived, reason: str, decision: str = "predict") -> None:
    """Request samples for the cloud in use."""
    state, params = turn.state, turn.params
    turn.set(phase=Phase.PREDICTING, observation=observation)
    seed = sample_seed(params.seed, state.step, state.grasps, state.trials)
    turn.do(
        Predict(
            observation.points,
            observation.stamp,
            state.memory.history,
            params.samples_per_request,
            seed,
        )
    )
    turn.say(decision, reason)


def choose(turn: Turn, event: PredictionArrived, observation: CloudArrived) -> None:
    """Take the first acceptable sample, ask for more, or make do after too many rejections."""
    params = turn.params
    why = "no samples"
    last: Choice | None = None
    for row in range(len(event.flows)):
        choice, why = assess(turn, event.points, event.flows[row], row, event.stamp)
        if choice is not None and choice.penalty == 0:
            act(turn, choice, why)
            return
        last = choice
        closest = turn.state.closest
        if choice is not None and (closest is None or choice.penalty < closest.penalty):
            closest = choice
        turn.set(trials=turn.state.trials + 1, closest=closest)
        if turn.state.trials >= params.max_resamples:
            break
    if turn.state.trials < params.max_resamples and len(event.flows):
        ask(turn, observation, f"sample rejected: {why}", "resample")
        return
    forced = turn.state.closest if params.on_exhausted == "closest" or last is None else last
    if forced is None:
        nothing_moves(turn)
        return
    why = f"{turn.state.trials} samples rejected, the {params.on_exhausted} is used"
    act(turn, completed(turn, event.points, forced), why)


def nothing_moves(turn: Turn) -> None:
    """No sample gives any point a motion."""
    reason = "no visible point is predicted to move"
    if turn.state.attached:
        attempts.fail(turn, reason + " while the part is held")
    else:
        attempts.end(turn, Outcome.NOT_VISIBLE, reason)


def act(turn: Turn, choice: Choice, why: str) -> None:
    """Grasp, switch the grasp, or pull on, as the chosen sample says."""
    if not turn.state.attached:
        attempts.approach(turn, choice, f"{why}; {_describe(choice)}")
        return
    gain = leverage_gain(turn, choice)
    if turn.params.switch_grasp and gain > turn.params.leverage:
        if attempts.may_contact(turn):
            turn.set(choice=choice, after_retreat=After.APPROACH)
            _switch(turn, f"{why}; another grasp gains {gain:.2f} of leverage; {_describe(choice)}")
            return
        why += f"; a switch would gain {gain:.2f} but no contact is left"
    step(turn, choice, why)


def _describe(choice: Choice) -> str:
    x, y, z = choice.grasp.point
    u, v, w = choice.grasp.direction
    return f"grasp ({x:.3f}, {y:.3f}, {z:.3f}) m, pull ({u:.2f}, {v:.2f}, {w:.2f})"


def _switch(turn: Turn, reason: str) -> None:
    turn.pump(0.0)
    turn.set(attached=False, phase=Phase.RELEASING)
    turn.say("switch", reason, switched=True)


def leverage_gain(turn: Turn, choice: Choice) -> float:
    """Flow norm that the chosen grasp has more than the present one.

    The arm hides the very spot that it holds, so the visible point nearest to the cup may belong
    to the frame; then the fitted rigid motion gives the flow at the cup.
    """
    grasp, observation = choice.grasp, turn.state.observation
    if observation is None:
        return 0.0
    distances = np.linalg.norm(observation.points - turn.state.tool, axis=1)
    nearest = int(np.argmin(distances))
    hidden = float(distances[nearest]) > turn.params.occlusion_radius
    if hidden and turn.params.occluded_leverage_from_screw and grasp.screw is not None:
        there = grasp.screw.flow_at(turn.state.tool)
        return float(np.linalg.norm(grasp.screw.flow_at(grasp.point)) - np.linalg.norm(there))
    return grasp.norm - float(np.linalg.norm(choice.flow[nearest]))


def step(turn: Turn, choice: Choice, why: str) -> None:
    """Pull the held part along the chosen flow."""
    params, state = turn.params, turn.state
    grasp = choice.grasp
    pull = grasp.direction
    if params.grasp.direction == "screw" and grasp.screw is not None:
        there = grasp.screw.flow_at(state.tool)
        if np.linalg.norm(there) > 0.05 and angle_between(there, pull) < np.pi / 2:
            pull = unit(there)
    opening = turn.opening
    distance = params.step_distance
    if params.opening.limit_last_step and opening.share > 0:
        shortest = min(2 * params.epsilon_m, distance)
        distance = float(np.clip(opening.remaining() + _LAST_STEP_PLAY, shortest, distance))
    distance = min(distance, state.reach)
    joint = (
        expected_joint(state.travel, grasp.screw, params.opening)
        if params.send_joint_estimate
        else None
    )
    turn.set(choice=choice, pull=pull, distance=distance)
    turn.move(
        MotionGoal(MotionKind.FLOW_STEP, direction=pull, distance=distance, joint=joint),
        Phase.STEPPING,
    )
    x, y, z = pull
    turn.say(
        "step",
        f"{why}; pull {100 * distance:.1f} cm along ({x:.2f}, {y:.2f}, {z:.2f})",
    )
