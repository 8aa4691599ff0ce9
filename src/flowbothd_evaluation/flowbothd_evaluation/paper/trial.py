"""One trial: one object, from closed, with the floating gripper; always one record."""

from __future__ import annotations

import hashlib
import time
import traceback
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

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
from flowbothd_evaluation.records import NONE, TRUTH, PaperRecord, PullSignals, Seconds
from flowbothd_evaluation.rollout.driver import PolicyDriver
from flowbothd_evaluation.rollout.floating import SUCCESS, FloatingPolicyWorld, TargetOnly
from flowbothd_evaluation.run_record.record import RunRecord
from flowbothd_evaluation.run_record.signals import pull_signals
from flowbothd_policy.commands import Decision
from flowbothd_policy.predictor import FlowPredictor
from sim_bridge.floating import FloatingWorld
from sim_bridge.objects.model import ObjectModel
from sim_bridge.oracle import GroundTruthFlow, OracleParams, OraclePredictor

if TYPE_CHECKING:
    from flowbothd_model.metrics import FlowErrors


@dataclass(frozen=True)
class PaperTrial:
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

    @property
    def key(self) -> Hashable:
        """That of its record."""
        return self.nothing_pulled(Outcome.ERROR, "").key

    def nothing_pulled(self, outcome: Outcome, reason: str) -> PaperRecord:
        """Return the record of this trial if nothing comes of it."""
        return PaperRecord(
            object=self.case.name,
            category=self.case.category,
            target_mask=self.target_mask,
            trial=self.trial,
            method=self.method,
            switches="+".join(self.switches),
            policy=self.policy,
            weights=self.weights,
            weights_sha256=self.weights_digest,
            max_steps=self.steps,
            base_seed=self.seed,
            seed=self.own_seed,
            link=self.link,
            joint="",
            outcome=outcome,
            reason=reason,
            success=False,
            open_ratio=0.0,
            normalized_distance=1.0,
            steps=0,
            grasps=0,
            per_step=PullSignals(),
            seconds=Seconds(),
        )


def run_trial(trial: PaperTrial) -> PaperRecord:
    """Do a trial; whatever happens is a record."""
    begun = time.perf_counter()
    try:
        _, record = evaluation_rollout(trial)
    except InvalidCloudError as error:
        record = trial.nothing_pulled(Outcome.NOT_VISIBLE, str(error))
    except FlowBotError as error:
        record = trial.nothing_pulled(Outcome.ERROR, str(error))
    except Exception as error:
        # A trial that is missing would flatter the method, whatever went wrong in it.
        where = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{where.name}, line {where.lineno}"
        reason = f"{type(error).__name__} in {place}: {error}"
        record = trial.nothing_pulled(Outcome.ERROR, reason)
    wall = round(time.perf_counter() - begun, 3)
    return replace(record, seconds=replace(record.seconds, wall=wall))


@lru_cache(maxsize=4)
def _loaded(case: Case) -> ObjectModel:
    return case.load()


def evaluation_rollout(trial: PaperTrial) -> tuple[RunRecord, PaperRecord]:
    """Do a trial, and return its whole course and its record.

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
        predicting, simulating = round(judge.seconds, 3), round(adapter.seconds, 3)
    # What the part does after the end of the run does not count: nothing holds it any more.
    summary = run.summary()
    success = ratio > SUCCESS
    signals = _per_step(run, judge)
    record = replace(
        trial.nothing_pulled(_outcome(summary.outcome, success=success), summary.reason),
        link=joint.child,
        joint=joint.name,
        success=success,
        open_ratio=round(ratio, 4),
        normalized_distance=round(1.0 - ratio, 4),
        steps=len(signals.open_ratio),
        grasps=summary.grasps,
        per_step=signals,
        seconds=Seconds(simulated=summary.sim_s, predicting=predicting, world=simulating),
    )
    return run, record


def _outcome(declared: str, *, success: bool) -> Outcome:
    """The policy's own word, but the joint decides whether the part is open."""
    if success:
        return Outcome.OPENED
    # A policy that thinks it is done has, by the joint, not opened the part.
    return Outcome.NOT_OPENED if declared == Outcome.OPENED else Outcome(declared)


def _predictor(trial: PaperTrial, chosen: Method, adapter: FloatingPolicyWorld) -> FlowPredictor:
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


def _per_step(run: RunRecord, judge: _Judge) -> PullSignals:
    """One entry a pull; the errors are those of the sample that was acted upon."""
    signals = pull_signals(run)
    pulls = [decision for decision in run.decisions if decision.decision == "step"]
    errors = [_errors(run, judge, decision) for decision in pulls]
    return replace(
        signals,
        open_ratio=tuple(None if r is None else round(r, 4) for r in signals.open_ratio),
        cosine=_column(errors, "cosine"),
        mean_error=_column(errors, "mean_error"),
        rmse=_column(errors, "rmse"),
    )


def _column(errors: Sequence[FlowErrors | None], name: str) -> tuple[float | None, ...]:
    return tuple(None if e is None else round(float(getattr(e, name)[0]), 4) for e in errors)


def _errors(run: RunRecord, judge: _Judge, decision: Decision) -> FlowErrors | None:
    """Errors of the sample behind a decision; None where nothing moves in the truth."""
    import torch

    from flowbothd_model.metrics import flow_errors

    stamp = decision.prediction_stamp
    asked = [i for i, p in enumerate(run.predictions) if p.stamp == stamp]
    if not asked:
        return None
    index = asked[-1]
    truth = torch.from_numpy(judge.truths[index])
    if not bool(truth.any()):
        return None
    flow = run.predictions[index].flows[decision.chosen_sample]
    return flow_errors(torch.from_numpy(flow[None].copy()), truth)
