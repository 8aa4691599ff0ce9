"""Options of a training run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flowbothd_model.config import PRESETS
from flowbothd_model.data.sampling import Situation


@dataclass(frozen=True)
class TrainConfig:
    """Settings of a run.

    Attributes:
        out: Folder of the run.
        init: Weights to begin with, empty = random ones.
        preset: Which model.
        data: `procedural`, or a PartNet-Mobility folder (mixed with procedural objects).
        partnet_share: Share of PartNet objects where there are any.
        categories: Procedural categories to train on, separated by commas; empty = all 21.
        situations: Any of closed, open, open_with_history, separated by commas: FlowBot3D of the
            paper trains on `open` alone or on `closed,open`.
        steps: Optimiser steps of the whole run.
        batch: Clouds per step and process.
        draws: Noise levels per cloud.
        rate: Peak learning rate; 0 = the preset's (compact 1e-3, others 1e-4).
        warmup: Steps of linear warm-up.
        decay: Share of the run, at its end, over which the rate falls to zero.
        weight_decay: Of AdamW.
        ema: Decay of the averaged weights.
        clip: Largest gradient norm.
        points: Per cloud.
        robot_share: Share of views by a robot's camera.
        own_histories: Share of the histories whose flow is what the network itself says at that
            moment, as in a run, and not the truth (`own_history.py`); 0 is the paper's.
        workers: Data processes; 0 = in the training process.
        seed: Of everything.
        precision: `fp32` or `bf16` (mixed).
        device: `auto`, `cpu` or `cuda`.
        save_every: Steps between saved states.
        validate_every: Steps between validations, 0 = never.
        validation_samples: Clouds of the validation.
    """

    out: Path
    init: str = ""
    preset: str = "compact"
    data: str = "procedural"
    partnet_share: float = 0.5
    categories: str = ""
    situations: str = ",".join(Situation)
    steps: int = 20_000
    batch: int = 32
    draws: int = 2
    rate: float = 0.0
    warmup: int = 200
    decay: float = 0.3
    weight_decay: float = 1e-5
    ema: float = 0.999
    clip: float = 1.0
    points: int = 1024
    robot_share: float = 0.5
    own_histories: float = 0.0
    workers: int = 1
    seed: int = 0
    precision: str = "fp32"
    device: str = "auto"
    save_every: int = 200
    validate_every: int = 1000
    validation_samples: int = 48

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.preset not in PRESETS:
            raise ValueError(f"preset must be one of {sorted(PRESETS)}, got {self.preset!r}")
        if self.precision not in ("fp32", "bf16"):
            raise ValueError(f"precision must be fp32 or bf16, got {self.precision!r}")
        unknown = set(self.situations.split(",")) - set(Situation)
        if unknown:
            raise ValueError(f"no such situations: {sorted(unknown)}; there are {list(Situation)}")
        for name in ("steps", "batch", "draws", "save_every", "validation_samples"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")

        for name in ("partnet_share", "robot_share", "own_histories"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be within 0 to 1, got {getattr(self, name)}")

    @property
    def peak_rate(self) -> float:
        """The peak learning rate."""
        if self.rate:
            return self.rate
        return 1e-3 if self.preset.startswith("compact") else 1e-4

    def rate_at(self, step: int) -> float:
        """Learning rate of one step: up, level, and down to zero at the end of the run."""
        up = min(1.0, (step + 1) / max(1, self.warmup))
        tail = self.decay * self.steps
        down = min(1.0, (self.steps - step) / tail) if tail else 1.0
        return self.peak_rate * min(up, max(0.0, down))
