"""Trials of the arm or of the floating gripper in its place: sets of them, and one run of each."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flowbothd_common.errors import FlowBotError
from flowbothd_common.types import Outcome
from flowbothd_evaluation.records import ArmRecord, Seconds
from flowbothd_evaluation.run_record.record import RunSummary

DOOR_MODES = ("pull_left", "pull_right", "push_left", "push_right")
FURNITURE = ("drawer", "cabinet_door", "lidded_box")
ARM, FLOATING = "arm", "floating"

METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "oracle": ("oracle", {}),
    "ambiguous": ("ambiguous", {}),
    "ambiguous-paper": ("ambiguous", {"reject_failed_directions": False}),
}
"""Method -> predictor, and the policy's parameters that differ from their defaults."""

MODEL = "model:"
"""Prefix of a method that is a network: the name, folder or file of its weights follows."""


@dataclass(frozen=True)
class ArmTrial:
    """One run to make.

    Attributes:
        suite: Part of the table that it belongs to.
        world: ARM or FLOATING.
        object: Scene, or path of a PartNet-Mobility folder.
        mode: Mode of the object, or empty.
        target: Target joint, empty = the object's own.
        method: One of METHODS (ambiguous-paper may try failed directions again), or MODEL and
            weights.
        seed: Run seed.
    """

    suite: str
    world: str
    object: str
    mode: str
    target: str
    method: str
    seed: int

    @property
    def key(self) -> tuple[str, str, str, str, str, str, int]:
        """That of its record."""
        return self.record(_FAILED).key

    def record(
        self, summary: RunSummary, contacts: dict[str, float] | None = None, wall: float = 0.0
    ) -> ArmRecord:
        """Return the record of this trial with the figures of its run."""
        return ArmRecord(
            suite=self.suite,
            world=self.world,
            object=Path(self.object).name,
            mode=self.mode,
            target=self.target,
            method=self.method,
            seed=self.seed,
            predictor=summary.predictor,
            outcome=Outcome(summary.outcome),
            reason=summary.reason,
            success=summary.success,
            open_ratio=summary.open_ratio,
            open_ratio_left=summary.open_ratio_left,
            steps=summary.steps,
            grasps=summary.grasps,
            resamples=summary.resamples,
            peak_force=summary.peak_force,
            contacts=contacts or {},
            seconds=Seconds(wall=wall, simulated=summary.sim_s),
        )


_FAILED = RunSummary(
    success=False,
    open_ratio=0.0,
    open_ratio_left=0.0,
    outcome=Outcome.ERROR.value,
    reason="",
    steps=0,
    grasps=0,
    resamples=0,
    object="",
    mode="",
    seed=0,
    predictor="",
    wall_s=0.0,
    sim_s=0.0,
    peak_force=0.0,
)


def door_trials(methods: Sequence[str], seeds: int) -> Iterator[ArmTrial]:
    """Yield trials of the four-mode door, by the arm."""
    for method in methods:
        for mode in DOOR_MODES:
            for seed in range(seeds):
                yield ArmTrial("door", ARM, "custom_door", mode, "", method, seed)


def furniture_trials(methods: Sequence[str], seeds: int) -> Iterator[ArmTrial]:
    """Yield trials of procedural furniture, by the arm."""
    for method in methods:
        for name in FURNITURE:
            for seed in range(seeds):
                yield ArmTrial("furniture", ARM, name, "", "", method, seed)


def partnet_trials(
    folders: Sequence[Path], methods: Sequence[str], seeds: int
) -> Iterator[ArmTrial]:
    """Yield trials of every movable joint of PartNet-Mobility objects, by the floating gripper."""
    from sim_bridge.objects.registry import load_object

    for folder in folders:
        for joint in load_object(folder).joints:
            for method in methods:
                for seed in range(seeds):
                    yield ArmTrial("partnet", FLOATING, str(folder), "", joint, method, seed)


def run_trial(trial: ArmTrial) -> ArmRecord:
    """Run one trial; always a record, whatever happens."""
    began = time.perf_counter()
    try:
        summary, contacts = _rollout(trial)
    except FlowBotError as error:
        summary, contacts = replace(_FAILED, reason=str(error)), {}
    return trial.record(summary, contacts, round(time.perf_counter() - began, 1))


def _rollout(trial: ArmTrial) -> tuple[RunSummary, dict[str, float]]:
    """Figures of the run, and the arm's contacts."""
    from flowbothd_evaluation.paper.methods import load_weights

    named = trial.method.startswith(MODEL)
    network = load_weights(trial.method.removeprefix(MODEL)) if named else None
    predictor, changes = METHODS.get(trial.method, ("", {}))
    if trial.world == FLOATING:
        from flowbothd_evaluation.rollout.floating import FLOATING_POLICY, floating_rollout
        from sim_bridge.objects.registry import load_object

        model = load_object(trial.object, seed=trial.seed)
        model = model.with_target(trial.target) if trial.target else model
        params = replace(FLOATING_POLICY, seed=trial.seed, **changes)
        return floating_rollout(model, params, predictor=network).summary(), {}
    from flowbothd_evaluation.rollout.arm import arm_rollout
    from sim_bridge.scenes import scene_for

    record, contacts = arm_rollout(
        scene_for(trial.object),
        seed=trial.seed,
        mode=trial.mode,
        predictor=network or predictor,
        policy=changes,
    )
    return record.summary(), contacts
