"""What is kept of one run, whoever drove it, and what is derived from it for people."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from flowbothd_common.motion import MotionResult
from flowbothd_common.types import Array, Cloud


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


@dataclass
class RunRecord:
    """One run from start to outcome.

    Attributes:
        object: Name of the scene or object.
        mode: Mode that was drawn; empty for objects without modes.
        seed: Run seed.
        predictor: Who predicted.
        decisions: The policy's decisions as dictionaries, in order.
        states: The world over time.
        predictions: All predictions.
        motions: Motion results as dictionaries, in order.
        wall_s: Wall-clock duration [s].
    """

    object: str
    mode: str
    seed: int
    predictor: str
    decisions: list[dict[str, Any]] = field(default_factory=list)
    states: list[StateSample] = field(default_factory=list)
    predictions: list[PredictionSample] = field(default_factory=list)
    motions: list[dict[str, Any]] = field(default_factory=list)
    wall_s: float = 0.0

    @property
    def outcome(self) -> str:
        """The policy's outcome, empty while it runs."""
        return str(self.decisions[-1]["outcome"]) if self.decisions else ""

    @property
    def open_ratio(self) -> float:
        """Of the target joint when the policy declared the run over; 0 if nothing was recorded.

        What gravity or the departing arm do to the part afterwards is `open_ratio_left`.
        """
        declared = [d["time"] for d in self.decisions if d["decision"] == "end"]
        return self.open_ratio_at(declared[0]) if declared else self.open_ratio_left

    @property
    def open_ratio_left(self) -> float:
        """Of the target joint when the arm has gone; 0 if nothing was recorded."""
        return self.states[-1].open_ratio if self.states else 0.0

    def open_ratio_at(self, time: float) -> float:
        """Of the target joint at the last sample not later than `time`."""
        earlier = [state.open_ratio for state in self.states if state.time <= time]
        return earlier[-1] if earlier else 0.0

    def summary(self) -> dict[str, Any]:
        """What `summary.json` holds."""
        last = self.decisions[-1] if self.decisions else {}
        start = self.states[0].time if self.states else 0.0
        end = self.states[-1].time if self.states else 0.0
        return {
            "success": bool(self.open_ratio > 0.9),
            "open_ratio": round(self.open_ratio, 4),
            "open_ratio_left": round(self.open_ratio_left, 4),
            "outcome": self.outcome or "not_opened",
            "reason": last.get("reason", ""),
            "steps": int(last.get("step", 0)),
            "grasps": int(last.get("grasps", 0)),
            "resamples": sum(1 for d in self.decisions if d["decision"] == "resample"),
            "object": self.object,
            "mode": self.mode,
            "seed": self.seed,
            "predictor": self.predictor,
            "wall_s": round(self.wall_s, 1),
            "sim_s": round(end - start, 2),
            "peak_force": round(max((m["peak_force"] for m in self.motions), default=0.0), 1),
        }


def motion_entry(result: MotionResult, time: float) -> dict[str, Any]:
    """What the record keeps of a MotionResult value."""
    return {
        "time": time,
        "motion": result.kind.value,
        "reason": result.reason.value,
        "message": result.message,
        "reached_fraction": result.reached_fraction,
        "tool_motion": result.tool_motion,
        "contact": result.contact,
        "vacuum": result.vacuum,
        "peak_force": float(np.linalg.norm(result.peak_wrench[:3])),
        "max_lag": result.max_lag,
        "duration": result.duration,
    }


def as_plain(value: Any) -> Any:
    """The value with arrays as lists, enums as their values, dataclasses as dictionaries."""
    if is_dataclass(value) and not isinstance(value, type):
        return as_plain(asdict(value))
    if isinstance(value, dict):
        return {str(k): as_plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [as_plain(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value.value if isinstance(value, Enum) else value


def save_record(record: RunRecord, folder: Path) -> None:
    """Write the record as record.json and predictions.npz."""
    plain = {key: value for key, value in vars(record).items() if key != "predictions"}
    write_json(folder / "record.json", {"summary": record.summary(), **plain})
    arrays = {
        f"{name}_{i}": np.asarray(getattr(prediction, name))
        for i, prediction in enumerate(record.predictions)
        for name in ("stamp", "points", "flows")
    }
    np.savez_compressed(folder / "predictions.npz", **arrays)  # type: ignore[arg-type]


def load_record(folder: Path) -> RunRecord:
    """Read back what `save_record` wrote."""
    plain = json.loads((folder / "record.json").read_text())
    plain.pop("summary")
    states = [
        StateSample(s["time"], np.array(s["arm"]), s["joints"], s["open_ratio"])
        for s in plain.pop("states")
    ]
    with np.load(folder / "predictions.npz") as arrays:
        predictions = [
            PredictionSample(
                float(arrays[f"stamp_{i}"]), arrays[f"points_{i}"], arrays[f"flows_{i}"]
            )
            for i in range(len(arrays.files) // 3)
        ]
    return RunRecord(**plain, states=states, predictions=predictions)


def write_json(path: Path, value: Any) -> None:
    """Write `value` as indented JSON, replacing the file in one move."""
    temporary = path.with_suffix(path.suffix + ".part")
    temporary.write_text(json.dumps(as_plain(value), indent=1) + "\n")
    temporary.replace(path)
