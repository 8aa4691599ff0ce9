"""The training loop: deterministic, resumable at any step, on one or several processes."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from flowbothd_model.checkpoint import read_checkpoint, save_checkpoint
from flowbothd_model.config import PRESETS, Architecture
from flowbothd_model.data.stream import Batch, BatchStream, Mixture
from flowbothd_model.network.factory import build
from flowbothd_model.training.objective import Objective, step_generator
from flowbothd_model.training.run_log import RunLog
from flowbothd_model.training.train_config import TrainConfig
from flowbothd_model.training.validation import ValidationSet

log = logging.getLogger(__name__)


def average(averaged: dict[str, Tensor], network: nn.Module, decay: float) -> None:
    """Move the averaged weights towards those of the network; counters are copied."""
    with torch.no_grad():
        for name, value in network.state_dict().items():
            if value.is_floating_point():
                averaged[name].lerp_(value, 1 - decay)
            else:
                averaged[name].copy_(value)


class Trainer:
    """One run; everything it needs to go on is in `out/state.pt`.

    Args:
        config: Of the run.
        mixture: What to train on.
        validation: What to validate on, or None.
    """

    def __init__(
        self, config: TrainConfig, mixture: Mixture, validation: ValidationSet | None = None
    ) -> None:
        self.config = config
        self.model_config = PRESETS[config.preset]
        self._mixture = mixture
        self._validation = validation
        self.rank, self.processes = (
            int(os.environ.get("RANK", "0")),
            int(os.environ.get("WORLD_SIZE", "1")),
        )
        self.device = _device(config.device)
        generator = torch.Generator().manual_seed(config.seed)
        self.network = build(self.model_config.network, generator).to(self.device)
        if config.init:
            given = read_checkpoint(Path(config.init)).tensors
            fit = set(self.network.state_dict())
            given = {k: v for k, v in given.items() if k in fit}
            missing = self.network.load_state_dict(given, strict=False).missing_keys
            log.info("began with %s; new: %s", config.init, missing or "nothing")
        self.averaged = {k: v.detach().clone() for k, v in self.network.state_dict().items()}
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=config.peak_rate, weight_decay=config.weight_decay
        )
        self.step = 0
        self.best = float("inf")
        self._stop = False
        self._objective: nn.Module = Objective(
            self.network, self.model_config, config.draws, config.own_histories
        )
        if self.processes > 1:
            # A batch of the published network may be without any history, its encoder then idle.
            idle = self.model_config.network.architecture is Architecture.PAPER
            self._objective = nn.parallel.DistributedDataParallel(
                self._objective, find_unused_parameters=idle
            )
        if self._state_path.is_file():
            self._resume()
        self._log = RunLog(config.out, self.step, enabled=self.rank == 0)

    @property
    def _state_path(self) -> Path:
        return self.config.out / "state.pt"

    def run(self) -> float:
        """Train until the last step, or until SIGTERM or SIGINT; returns the last loss."""
        loader = DataLoader(
            BatchStream(
                self._mixture,
                self.config.batch,
                self.step * self.processes + self.rank,
                self.processes,
            ),
            batch_size=None,
            num_workers=self.config.workers,
            prefetch_factor=4 if self.config.workers else None,
            worker_init_fn=_quiet_worker,
        )
        batches: Iterator[Batch] = iter(loader)
        loss = float("nan")
        self._objective.train()
        with _signals(self._ask_to_stop), self._log.progress(self.config.steps) as bar:
            started = time.monotonic()
            while self.step < self.config.steps and not self._stop:
                loss = self._one_step(next(batches))
                self._log.loss(
                    self.step, loss, self.config.rate_at(self.step - 1), time.monotonic() - started
                )
                bar.update(1)
                if self._due(self.config.save_every):
                    self.save()
                if self._due(self.config.validate_every):
                    self._validate()
        self.save()
        if self.step >= self.config.steps and not self._due(self.config.validate_every):
            self._validate()
        return loss

    def _due(self, every: int) -> bool:
        return bool(every) and self.step % every == 0

    def _ask_to_stop(self, number: int, _frame: FrameType | None) -> None:
        log.info("signal %d: saving the state and stopping after this step", number)
        self._stop = True

    def _one_step(self, batch: Batch) -> float:
        """One optimiser step."""
        config = self.config
        for group in self._optimiser.param_groups:
            group["lr"] = config.rate_at(self.step)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=config.precision == "bf16"):
            loss = self._objective(
                batch.to(self.device), step_generator(config.seed, self.step, self.rank)
            )
        self._optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(self.network.parameters(), config.clip)
        self._optimiser.step()
        self.step += 1
        average(self.averaged, self.network, min(config.ema, (1 + self.step) / (10 + self.step)))
        return float(loss.detach())

    def save(self) -> None:
        """Write the state and the averaged weights, atomically; only the first process does."""
        if self.rank:
            return
        self.config.out.mkdir(parents=True, exist_ok=True)
        state = {
            "step": self.step,
            "best": self.best,
            "network": self.network.state_dict(),
            "averaged": self.averaged,
            "optimiser": self._optimiser.state_dict(),
        }
        part = self._state_path.with_suffix(".part")
        torch.save(state, part)
        part.replace(self._state_path)
        self._export("latest.safetensors")

    def _export(self, name: str) -> None:
        about = {"step": str(self.step), "data": _kind_of(self.config.data)}
        save_checkpoint(self.config.out / name, self.model_config, self.averaged, about)

    def _resume(self) -> None:
        state: dict[str, Any] = torch.load(
            self._state_path, map_location=self.device, weights_only=True
        )
        self.network.load_state_dict(state["network"])
        self.averaged = state["averaged"]
        self._optimiser.load_state_dict(state["optimiser"])
        self.step, self.best = int(state["step"]), float(state["best"])
        log.info("resumed at step %d", self.step)

    def _validate(self) -> None:
        """Measure the averaged weights; keep those with the least winner-take-all error."""
        if self._validation is None or self.rank:
            return
        shadow = build(self.model_config.network).to(self.device)
        shadow.load_state_dict(self.averaged)
        scores = self._validation.measure(shadow.eval(), self.model_config)
        self._log.validation(self.step, scores)
        if scores["wta_mean_error"] < self.best:
            self.best = scores["wta_mean_error"]
            self._export("best.safetensors")


def _kind_of(data: str) -> str:
    return data if data == "procedural" else "procedural+partnet-mobility"


def _device(name: str) -> torch.device:
    if name != "auto":
        return torch.device(name)
    if not torch.cuda.is_available():
        return torch.device("cpu")
    return torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))


def _quiet_worker(_worker: int) -> None:
    """Data processes use one thread each and leave signals to the training process.

    They end when it does; ended by a signal to the whole group, they would take its last steps.
    """
    torch.set_num_threads(1)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def _signals(handler: Any) -> Iterator[None]:
    """Handle SIGTERM and SIGINT by `handler` meanwhile, where signals can be handled."""
    numbers = (signal.SIGTERM, signal.SIGINT)
    try:
        before = [signal.signal(number, handler) for number in numbers]
    except ValueError:  # not the main thread
        yield
        return
    try:
        yield
    finally:
        for number, old in zip(numbers, before, strict=True):
            signal.signal(number, old)
