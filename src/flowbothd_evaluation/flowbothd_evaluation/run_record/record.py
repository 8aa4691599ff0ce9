"""The record of one run, stepped or through nodes, and the figures derived from it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from flowbothd_common.motion import MotionKind, MotionReason, MotionResult
from flowbothd_common.types import Array, Cloud, Outcome
from flowbothd_evaluation.record_files import from_json, to_json, write_text
from flowbothd_policy.commands import Decision

OPEN = 0.9
"""Open ratio above which a part counts as open."""


@dataclass(frozen=True)
class StateSample:
    """The simulated world at one instant.

    Attributes:
        time: Node clock [s].
        arm: (7,) joint positions [rad].
        joints: Object joint positions by name [rad or m].
        open_ratio: Of the target joint.
    """

    time: float
    arm: Array
    joints: dict[str, float]
    open_ratio: float


@dataclass(frozen=True)
class PredictionSample:
    """One answer of the predictor.

    Attributes:
        stamp: Stamp of the cloud [s].
        points: (N, 3) float32, base [m].
        flows: (S, N, 3) float32, max-normalised.
    """

    stamp: float
    points: Cloud
    flows: Cloud


@dataclass(frozen=True)
class MotionEntry:
    """The result of one motion.

    Attributes:
        time: When it ended [s, node clock].
        motion: Which motion.
        reason: Why it ended.
        message: For people.
        reached_fraction: Of the commanded path, 0..1.
        tool_motion: (3,) measured displacement of the suction tip in base [m].
        contact: The tool touches something.
        vacuum: The cup holds a part.
        peak_force: Largest force on the tool [N].
        max_lag: Largest joint difference between reference and command [rad].
        duration: [s, node clock].
    """

    time: float
    motion: MotionKind
    reason: MotionReason
    message: str
    reached_fraction: float
    tool_motion: Array
    contact: bool
    vacuum: bool
    peak_force: float
    max_lag: float
    duration: float

    @staticmethod
    def of(result: MotionResult, time: float) -> MotionEntry:
        """Return what the record keeps of a motion's result."""
        return MotionEntry(
            time=time,
            motion=result.kind,
            reason=result.reason,
            message=result.message,
            reached_fraction=result.reached_fraction,
            tool_motion=result.tool_motion,
            contact=result.contact,
            vacuum=result.vacuum,
            peak_force=float(np.linalg.norm(result.peak_wrench[:3])),
            max_lag=result.max_lag,
            duration=result.duration,
        )


@dataclass(frozen=True)
class RunSummary:
    """The figures of a run, as `summary.json` holds them.

    Attributes:
        success: The target joint was more than 0.9 open when the policy declared the run over.
        open_ratio: Of the target joint then.
        open_ratio_left: The same when the arm has gone.
        outcome: The policy's; not_opened while it has none.
        reason: Of the last decision.
        steps: Flow steps.
        grasps: Contacts.
        resamples: Predictions that were rejected.
        object: Name of the scene or object.
        mode: Mode that was drawn; empty for objects without modes.
        seed: Run seed.
        predictor: Identifies the predictor and its weights.
        wall_s: Wall-clock duration [s].
        sim_s: Duration on the clock of the world [s].
        peak_force: Largest force on the tool [N].
    """

    success: bool
    open_ratio: float
    open_ratio_left: float
    outcome: str
    reason: str
    steps: int
    grasps: int
    resamples: int
    object: str
    mode: str
    seed: int
    predictor: str
    wall_s: float
    sim_s: float
    peak_force: float


@dataclass
class RunRecord:
    """One run from start to outcome.

    Attributes:
        object: Name of the scene or object.
        mode: Mode that was drawn; empty for objects without modes.
        seed: Run seed.
        predictor: Identifies the predictor and its weights.
        decisions: The policy's decisions, in order.
        states: The world over time.
        predictions: All predictions; kept in a file of their own.
        motions: Motion results, in order.
        wall_s: Wall-clock duration [s].
    """

    KIND: ClassVar[str] = "run"

    object: str
    mode: str
    seed: int
    predictor: str
    decisions: list[Decision] = field(default_factory=list)
    states: list[StateSample] = field(default_factory=list)
    predictions: list[PredictionSample] = field(default_factory=list)
    motions: list[MotionEntry] = field(default_factory=list)
    wall_s: float = 0.0

    @property
    def outcome(self) -> str:
        """The policy's outcome, empty while it runs."""
        return self.decisions[-1].outcome if self.decisions else ""

    @property
    def open_ratio(self) -> float:
        """Of the target joint when the policy declared the run over; 0 if nothing was recorded.

        What gravity or the departing arm do to the part afterwards is `open_ratio_left`.
        """
        declared = [d.time for d in self.decisions if d.decision == "end"]
        return self.open_ratio_at(declared[0]) if declared else self.open_ratio_left

    @property
    def open_ratio_left(self) -> float:
        """Of the target joint when the arm has gone; 0 if nothing was recorded."""
        return self.states[-1].open_ratio if self.states else 0.0

    def open_ratio_at(self, time: float) -> float:
        """Of the target joint at the last sample not later than `time`."""
        earlier = [state.open_ratio for state in self.states if state.time <= time]
        return earlier[-1] if earlier else 0.0

    def summary(self) -> RunSummary:
        """Return the figures of the run."""
        last = self.decisions[-1] if self.decisions else None
        start = self.states[0].time if self.states else 0.0
        end = self.states[-1].time if self.states else 0.0
        return RunSummary(
            success=bool(self.open_ratio > OPEN),
            open_ratio=round(self.open_ratio, 4),
            open_ratio_left=round(self.open_ratio_left, 4),
            outcome=self.outcome or Outcome.NOT_OPENED.value,
            reason=last.reason if last else "",
            steps=last.step if last else 0,
            grasps=last.grasps if last else 0,
            resamples=sum(1 for d in self.decisions if d.decision == "resample"),
            object=self.object,
            mode=self.mode,
            seed=self.seed,
            predictor=self.predictor,
            wall_s=round(self.wall_s, 1),
            sim_s=round(end - start, 2),
            peak_force=round(max((m.peak_force for m in self.motions), default=0.0), 1),
        )


def save_record(record: RunRecord, folder: Path) -> None:
    """Write the record as record.json and predictions.npz."""
    write_text(folder / "record.json", to_json(replace(record, predictions=[]), indent=1) + "\n")
    arrays = {
        f"{name}_{i}": np.asarray(getattr(prediction, name))
        for i, prediction in enumerate(record.predictions)
        for name in ("stamp", "points", "flows")
    }
    np.savez_compressed(folder / "predictions.npz", **arrays)  # type: ignore[arg-type]


def load_record(folder: Path) -> RunRecord:
    """Return what `save_record` wrote.

    Raises:
        RecordError: record.json is not such a record.
    """
    file = folder / "record.json"
    record = from_json(RunRecord, file.read_text(), str(file))
    with np.load(folder / "predictions.npz") as arrays:
        record.predictions = [
            PredictionSample(
                float(arrays[f"stamp_{i}"]), arrays[f"points_{i}"], arrays[f"flows_{i}"]
            )
            for i in range(len(arrays.files) // 3)
        ]
    return record
