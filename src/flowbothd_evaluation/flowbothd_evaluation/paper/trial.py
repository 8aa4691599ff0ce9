"""One trial: one object, from closed, with the floating gripper; always one record."""

from __future__ import annotations

import hashlib
import time
import traceback
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import FlowBotError, InvalidCloudError
from flowbothd_common.types import Cloud, History, Outcome
from flowbothd_evaluation.paper.cases import Case
from flowbothd_evaluation.paper.methods import (
    Method,
    RandomPredictor,
    load_weights,
    method,
    policy_params,
)
from flowbothd_evaluation.resumable import Record
from flowbothd_evaluation.rollout.driver import PolicyDriver
from flowbothd_evaluation.rollout.floating import SUCCESS, FloatingPolicyWorld, TargetOnly
from flowbothd_evaluation.run_record.record import RunRecord
from flowbothd_evaluation.run_record.signals import signal_columns
from flowbothd_policy.predictor import FlowPredictor
from sim_bridge.floating import FloatingWorld
from sim_bridge.objects.model import ObjectModel
from sim_bridge.oracle import GroundTruthFlow, OracleParams, OraclePredictor

TRUTH, NONE = MASKS = ("truth", "none")
"""Which points may be grasped: those of the target link, or of the whole cloud."""


@dataclass(frozen=True)
class EvalTrial:
    """What to do.

    Attributes:
        case: The object.
        link: To be opened; empty = any that can be, by the whole cloud.
        trial: Number of the repetition.
        method: One of METHODS.
        switches: Parts of the policy that are on.
        policy: One of POLICIES.
        weights: Name or path; empty for methods without.
        steps: Pulls at most.
        seed: Of the whole evaluation.
        weights_digest: Of the file of weights: trained anew, they are others by the same name.
    """

    case: Case
    link: str
    trial: int
    method: str
    switches: tuple[str, ...]
    policy: str
    weights: str
    steps: int
    seed: int
    weights_digest: str = ""

    @property
    def target_mask(self) -> str:
        """As in the record."""
        return TRUTH if self.link else NONE

    @property
    def own_seed(self) -> int:
        """The same for every method, so that they are compared on the same draws."""
        text = f"{self.seed} {self.case.name} {self.link} {self.trial}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")

    def identity(self) -> Record:
        """The part of the record that is known before the trial."""
        return {
            "object": self.case.name,
            "category": self.case.category,
            "target_mask": self.target_mask,
            "trial": self.trial,
            "method": self.method,
            "switches": "+".join(self.switches),
            "policy": self.policy,
            "weights": self.weights,
            "weights_sha256": self.weights_digest,
            "max_steps": self.steps,
            "base_seed": self.seed,
            "seed": self.own_seed,
        }

    def key(self) -> Hashable:
        """By which its record is found again."""
        return record_key({**self.identity(), "link": self.link})


def record_key(record: Record) -> Hashable:
    """What tells one record from another; without a target the link is an outcome."""
    link = record["link"] if record["target_mask"] == TRUTH else ""
    names = ("object", "trial", "method", "switches", "policy", "weights", "max_steps", "base_seed")
    return (link, record.get("weights_sha256", ""), *(record[name] for name in names))


def run_trial(trial: EvalTrial) -> Record:
    """Do a trial; whatever happens is a record."""
    begun = time.perf_counter()
    try:
        _, result = evaluation_rollout(trial)
    except InvalidCloudError as error:
        result = failed(trial.link, Outcome.NOT_VISIBLE, str(error))
    except FlowBotError as error:
        result = failed(trial.link, Outcome.ERROR, str(error))
    except Exception as error:
        # A trial that is missing would flatter the method, whatever went wrong in it.
        where = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{where.name}, line {where.lineno}"
        reason = f"{type(error).__name__} in {place}: {error}"
        result = failed(trial.link, Outcome.ERROR, reason)
    seconds = {**result.pop("seconds", {}), "total": time.perf_counter() - begun}
    rounded = {name: round(value, 3) for name, value in seconds.items()}
    return {**trial.identity(), **result, "seconds": rounded}


def failed(link: str, outcome: Outcome, reason: str) -> Record:
    """The rest of the record of a trial in which nothing was pulled."""
    return {
        "link": link,
        "joint": "",
        "outcome": outcome.value,
        "reason": reason,
        "success": False,
        "open_ratio": 0.0,
        "normalized_distance": 1.0,
        "steps": 0,
        "grasps": 0,
        "per_step": {name: [] for name in (*_SIGNALS, *_ERRORS)},
    }


_SIGNALS = ("open_ratio", "history_updated", "grasp_switched", "consistency_trials")
_ERRORS = ("cosine", "mean_error", "rmse")


@lru_cache(maxsize=4)
def _loaded(case: Case) -> ObjectModel:
    return case.load()


def evaluation_rollout(trial: EvalTrial) -> tuple[RunRecord, Record]:
    """Do a trial; its whole course, and its record less the identity.

    Raises:
        FlowBotError: the object cannot be simulated, or nothing of it can be seen.
    """
    model = _loaded(trial.case)
    if trial.link:
        model = model.with_target(trial.link)
    chosen = method(trial.method)
    params = policy_params(chosen, trial.switches, trial.policy, trial.steps, trial.own_seed)
    openable = [j.name for j in model.joints.values() if j.child in trial.case.openable]
    counting = None if trial.link else openable or list(model.joints)
    with FloatingWorld(model, trial.own_seed) as world:
        adapter = _TimedWorld(world, counting)
        predictor = _predictor(trial, chosen, adapter)
        judge = _Judge(predictor, adapter, target_only=bool(trial.link))
        run = RunRecord(trial.case.name, "", trial.own_seed, predictor.model_id)
        PolicyDriver(adapter, judge, params, run, stop_at=SUCCESS).run()
        best = adapter.furthest()
        joint = model.target if trial.link else model.joints[best]
        ratio = float(np.clip(world.open_ratios()[joint.name], 0.0, 1.0))
        seconds = {"predict": judge.seconds, "world": adapter.seconds}
    # What the part does after the end of the run does not count: nobody touches it any more.
    summary = run.summary()
    success = ratio > SUCCESS
    signals = _per_step(run, judge)
    return run, {
        "link": joint.child,
        "joint": joint.name,
        "outcome": _outcome(summary["outcome"], success=success),
        "reason": summary["reason"],
        "success": success,
        "open_ratio": round(ratio, 4),
        "normalized_distance": round(1.0 - ratio, 4),
        "steps": len(signals["open_ratio"]),
        "grasps": summary["grasps"],
        "per_step": signals,
        "seconds": seconds,
    }


def _outcome(declared: str, *, success: bool) -> str:
    """The policy's own word, but the joint decides whether the part is open."""
    if success:
        return Outcome.OPENED.value
    # A policy that thinks it is done has, by the joint, not opened the part.
    return Outcome.NOT_OPENED.value if declared == Outcome.OPENED else declared


def _predictor(trial: EvalTrial, chosen: Method, adapter: FloatingPolicyWorld) -> FlowPredictor:
    only = bool(trial.link)
    predictor: FlowPredictor
    if chosen.name == "oracle":
        exact = OracleParams(noise=0.0, tilt=0.0)
        predictor = OraclePredictor(lambda p: adapter.truth(p, target_only=only), exact)
    elif trial.weights:
        predictor = load_weights(trial.weights, trial.weights_digest)
    else:
        predictor = RandomPredictor()
    return TargetOnly(predictor, adapter) if only else predictor


class _TimedWorld(FloatingPolicyWorld):
    """Knows how long the world took, and the truth of one cloud once."""

    seconds = 0.0
    _known: tuple[Cloud, GroundTruthFlow] | None = None

    def observe(self) -> Any:
        """See FloatingPolicyWorld."""
        return self._timed(super().observe)

    def move(self, goal: Any) -> Any:
        """See FloatingPolicyWorld."""
        return self._timed(lambda: super(_TimedWorld, self).move(goal))

    def truth(self, points: Cloud, *, target_only: bool) -> GroundTruthFlow:
        """See FloatingPolicyWorld; nothing moves between two questions about the same cloud."""
        if self._known is None or self._known[0] is not points:
            self._known = (points, super().truth(points, target_only=target_only))
        return self._known[1]

    def _timed(self, call: Callable[[], Any]) -> Any:
        begun = time.perf_counter()
        try:
            return call()
        finally:
            self.seconds += time.perf_counter() - begun


class _Judge:
    """A predictor that notes, for every answer, what would have been true.

    Args:
        predictor: Answers.
        world: Knows the truth.
        target_only: Of the target joint alone, or of all joints.
    """

    def __init__(
        self, predictor: FlowPredictor, world: FloatingPolicyWorld, *, target_only: bool
    ) -> None:
        self._predictor, self._world, self._target_only = predictor, world, target_only
        self.model_id = predictor.model_id
        self.seconds = 0.0
        self.truths: list[NDArray[np.float32]] = []

    def sample(
        self,
        points: Cloud,
        history: History | None = None,
        samples: int = 1,
        steps: int | None = None,
        sampler: str | None = None,
        seed: int | None = None,
    ) -> NDArray[np.float32]:
        """See `FlowPredictor.sample`."""
        self.truths.append(self._world.truth(points, target_only=self._target_only).flows[0])
        begun = time.perf_counter()
        flows = self._predictor.sample(points, history, samples, steps, sampler, seed)
        self.seconds += time.perf_counter() - begun
        return flows


def _per_step(run: RunRecord, judge: _Judge) -> dict[str, list[Any]]:
    """One entry a pull; the errors are those of the sample that was acted upon."""
    signals = signal_columns(run)
    errors = [
        _errors(run, judge, decision)
        for decision in run.decisions
        if decision["decision"] == "step"
    ]
    return {
        **signals,
        "open_ratio": [round(ratio, 4) for ratio in signals["open_ratio"]],
        **{name: [e.get(name) for e in errors] for name in _ERRORS},
    }


def _errors(run: RunRecord, judge: _Judge, decision: Record) -> Record:
    """Errors of the sample behind a decision; empty where nothing moves in the truth."""
    import torch

    from flowbothd_model.metrics import flow_errors

    stamp = decision["prediction_stamp"]
    asked = [i for i, p in enumerate(run.predictions) if p.stamp == stamp]
    if not asked:
        return {}
    index = asked[-1]
    truth = torch.from_numpy(judge.truths[index])
    if not bool(truth.any()):
        return {}
    flow = run.predictions[index].flows[decision["chosen_sample"]]
    found = flow_errors(torch.from_numpy(flow[None].copy()), truth)
    return {name: round(float(getattr(found, name)[0]), 4) for name in _ERRORS}
