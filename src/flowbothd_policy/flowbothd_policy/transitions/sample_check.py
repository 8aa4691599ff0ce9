"""Check of one sampled flow field: consistency, repetition of a failed pull, grasp."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.transforms import angle_between
from flowbothd_common.types import Array, Cloud
from flowbothd_policy.grasp_selection import Grasp, Place, select_grasp
from flowbothd_policy.history import is_consistent
from flowbothd_policy.state import Choice
from flowbothd_policy.transitions.transition import Transition

_CLEARLY = np.radians(20.0)
"""Angle beyond `consistency_angle` from which the largest flow alone rejects a sample [rad]."""
_REPEATS = "it repeats a pull that did not move the part"


def assess(
    transition: Transition, points: Cloud, flow: NDArray[np.float32], row: int, stamp: float
) -> tuple[Choice | None, str]:
    """Judge one sample: the choice with its penalty, and why; None if nothing moves in it.

    Up to fifty samples are judged for one step, nearly all of them to be rejected, and choosing
    a grasp costs much more than the checks; what its largest flow alone rules out gets none.
    """
    quick = _ruled_out(transition, points, flow)
    if quick is not None:
        grasp, penalty, why = quick
        return Choice(grasp, flow, row, stamp, penalty, complete=False), why
    state, params = transition.state, transition.params
    avoid = () if state.attached else state.avoided
    chosen = select_grasp(
        points,
        flow,
        params.grasp,
        leverage=params.leverage,
        avoid=avoid,
        avoid_angle=params.failed_angle,
    )
    penalty, why = 0.0, "sample accepted"
    if chosen is None and avoid:
        chosen = select_grasp(points, flow, params.grasp, leverage=params.leverage)
        penalty, why = np.pi, "all its grasp points lie where the cup or the arm failed"
    if chosen is None:
        return None, "nothing moves in it"
    consistent, angle = is_consistent(chosen.flow, state.memory, params, attached=state.attached)
    if not consistent:
        penalty, why = max(penalty, angle), _off(angle)
    repeated = _repeats(transition, points, flow, chosen)
    if repeated is not None:
        penalty, why = max(penalty, np.pi + repeated), _REPEATS
    elif penalty == 0 and np.isfinite(angle):
        why = f"sample accepted, {np.degrees(angle):.0f} deg off the last motion"
    return Choice(chosen, flow, row, stamp, penalty), why


def completed(transition: Transition, points: Cloud, choice: Choice) -> Choice:
    """A rejected choice with its grasp chosen properly, to be executed after all."""
    if choice.complete:
        return choice
    params = transition.params
    grasp = select_grasp(points, choice.flow, params.grasp, leverage=params.leverage)
    return choice if grasp is None else replace(choice, grasp=grasp, complete=True)


def _off(angle: float) -> str:
    return f"flow is {np.degrees(angle):.0f} deg off the last motion"


def _ruled_out(
    transition: Transition, points: Cloud, flow: NDArray[np.float32]
) -> tuple[Grasp, float, str] | None:
    """Grasp at the largest flow, penalty and reason where the sample is out of the question."""
    norms = np.linalg.norm(flow, axis=1)
    top = int(np.argmax(norms))
    largest = float(norms[top])
    if largest < 1e-6:
        return None
    own = flow[top].astype(float)
    grasp = Grasp(top, points[top].astype(float), own, largest, largest, None)
    repeated = _repeats(transition, points, flow, grasp)
    if repeated is not None:
        return grasp, np.pi + repeated, _REPEATS
    consistent, angle = is_consistent(
        own, transition.state.memory, transition.params, attached=transition.state.attached
    )
    # The largest flow is a noisy one: only what is far off may be judged by it.
    if not consistent and angle > transition.params.consistency_angle + _CLEARLY:
        return grasp, angle, _off(angle)
    return None


def _repeats(
    transition: Transition, points: Cloud, flow: NDArray[np.float32], grasp: Grasp
) -> float | None:
    """Return how closely a sample repeats a refuted pull [rad], or None if it does not.

    A pull at one place refutes every motion that would have let it succeed. So a sample is
    compared where the pull was made, not only where it would itself grasp: a door's free edge is
    long, and the same wrong hinge must not be tried again a hand's breadth higher.
    """
    params = transition.params
    worst: float | None = None
    for place in transition.state.refuted:
        agreements = []
        near = np.linalg.norm(grasp.point - place.point) < place.radius
        off = angle_between(grasp.flow, place.direction)
        if near and off < params.failed_angle:
            agreements.append(params.failed_angle - off)
        there = _flow_around(points, flow, place)
        if there is not None and np.linalg.norm(there) >= params.failed_norm * grasp.largest:
            off = angle_between(there, place.direction)
            if off < params.failed_angle:
                agreements.append(params.failed_angle - off)
        if agreements:
            worst = max(agreements) if worst is None else max(worst, *agreements)
    return worst


def _flow_around(points: Cloud, flow: NDArray[np.float32], place: Place) -> Array | None:
    """(3,) the largest flow of the few points nearest to a place, or None if none is near.

    The largest, because points of the frame, which never move, lie next to the part's edge.
    """
    distances = np.linalg.norm(points - place.point, axis=1)
    nearest = np.argsort(distances, kind="stable")[:5]
    nearest = nearest[distances[nearest] < place.radius]
    if not len(nearest):
        return None
    return np.asarray(flow[nearest[np.argmax(np.linalg.norm(flow[nearest], axis=1))]], dtype=float)
