"""Selection among sampled flow fields: rejection, grasp, switch of the grasp, next step."""

from __future__ import annotations

import numpy as np

from flowbothd_common.motion import MotionGoal, MotionKind
from flowbothd_common.transforms import angle_between, unit
from flowbothd_common.types import Outcome
from flowbothd_policy.commands import Predict
from flowbothd_policy.events import CloudArrived, PredictionArrived
from flowbothd_policy.opening import expected_joint
from flowbothd_policy.state import After, Choice, Phase
from flowbothd_policy.transitions import attempt
from flowbothd_policy.transitions.sample_check import assess, completed
from flowbothd_policy.transitions.transition import Transition

_LAST_STEP_PLAY = 0.01
"""Way beyond the target that the last step may go [m]: the opening is measured to about that."""


def sample_seed(run_seed: int, step: int, grasps: int, trial: int) -> int:
    """Seed of one request: the same run, step, contact and trial give the same samples."""
    entropy = np.random.SeedSequence((run_seed, step, grasps, trial))
    return int(entropy.generate_state(1, np.uint64)[0])


def ask(
    transition: Transition, observation: CloudArrived, reason: str, decision: str = "predict"
) -> None:
    """Request samples for the cloud in use."""
    state, params = transition.state, transition.params
    transition.set(phase=Phase.PREDICTING, observation=observation)
    seed = sample_seed(params.seed, state.step, state.grasps, state.trials)
    transition.do(
        Predict(
            observation.points,
            observation.stamp,
            state.memory.history,
            params.samples_per_request,
            seed,
        )
    )
    transition.say(decision, reason)


def choose(transition: Transition, event: PredictionArrived, observation: CloudArrived) -> None:
    """Take the first acceptable sample, ask for more, or make do after too many rejections."""
    params = transition.params
    why = "no samples"
    last: Choice | None = None
    for row in range(len(event.flows)):
        choice, why = assess(transition, event.points, event.flows[row], row, event.stamp)
        if choice is not None and choice.penalty == 0:
            act(transition, choice, why)
            return
        last = choice
        closest = transition.state.closest
        if choice is not None and (closest is None or choice.penalty < closest.penalty):
            closest = choice
        transition.set(trials=transition.state.trials + 1, closest=closest)
        if transition.state.trials >= params.max_resamples:
            break
    if transition.state.trials < params.max_resamples and len(event.flows):
        ask(transition, observation, f"sample rejected: {why}", "resample")
        return
    forced = transition.state.closest if params.on_exhausted == "closest" or last is None else last
    if forced is None:
        nothing_moves(transition)
        return
    why = f"{transition.state.trials} samples rejected, the {params.on_exhausted} is used"
    act(transition, completed(transition, event.points, forced), why)


def nothing_moves(transition: Transition) -> None:
    """No sample gives any point a motion."""
    reason = "no visible point is predicted to move"
    if transition.state.attached:
        attempt.fail(transition, reason + " while the part is held")
    else:
        attempt.end(transition, Outcome.NOT_VISIBLE, reason)


def act(transition: Transition, choice: Choice, why: str) -> None:
    """Grasp, switch the grasp, or pull on, as the chosen sample says."""
    if not transition.state.attached:
        attempt.approach(transition, choice, f"{why}; {_describe(choice)}")
        return
    gain = leverage_gain(transition, choice)
    if transition.params.switch_grasp and gain > transition.params.leverage:
        if attempt.may_contact(transition):
            transition.set(choice=choice, after_retreat=After.APPROACH)
            _switch(
                transition,
                f"{why}; another grasp gains {gain:.2f} of leverage; {_describe(choice)}",
            )
            return
        why += f"; a switch would gain {gain:.2f} but no contact is left"
    step(transition, choice, why)


def _describe(choice: Choice) -> str:
    x, y, z = choice.grasp.point
    u, v, w = choice.grasp.direction
    return f"grasp ({x:.3f}, {y:.3f}, {z:.3f}) m, pull ({u:.2f}, {v:.2f}, {w:.2f})"


def _switch(transition: Transition, reason: str) -> None:
    transition.pump(0.0)
    transition.set(attached=False, phase=Phase.RELEASING)
    transition.say("switch", reason, switched=True)


def leverage_gain(transition: Transition, choice: Choice) -> float:
    """Flow norm that the chosen grasp has more than the present one.

    The arm hides the very spot that it holds, so the visible point nearest to the cup may belong
    to the frame; then the fitted rigid motion gives the flow at the cup.
    """
    grasp, observation = choice.grasp, transition.state.observation
    if observation is None:
        return 0.0
    distances = np.linalg.norm(observation.points - transition.state.tool, axis=1)
    nearest = int(np.argmin(distances))
    hidden = float(distances[nearest]) > transition.params.occlusion_radius
    if hidden and transition.params.occluded_leverage_from_screw and grasp.screw is not None:
        there = grasp.screw.flow_at(transition.state.tool)
        return float(np.linalg.norm(grasp.screw.flow_at(grasp.point)) - np.linalg.norm(there))
    return grasp.norm - float(np.linalg.norm(choice.flow[nearest]))


def step(transition: Transition, choice: Choice, why: str) -> None:
    """Pull the held part along the chosen flow."""
    params, state = transition.params, transition.state
    grasp = choice.grasp
    pull = grasp.direction
    if params.grasp.direction == "screw" and grasp.screw is not None:
        there = grasp.screw.flow_at(state.tool)
        if np.linalg.norm(there) > 0.05 and angle_between(there, pull) < np.pi / 2:
            pull = unit(there)
    opening = transition.opening
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
    transition.set(choice=choice, pull=pull, distance=distance)
    transition.move(
        MotionGoal(MotionKind.FLOW_STEP, direction=pull, distance=distance, joint=joint),
        Phase.STEPPING,
    )
    x, y, z = pull
    transition.say(
        "step",
        f"{why}; pull {100 * distance:.1f} cm along ({x:.2f}, {y:.2f}, {z:.2f})",
    )
