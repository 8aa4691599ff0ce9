"""`flowbothd train`: train a preset, on one device or, under torchrun, on several.

    flowbothd train --preset compact --data procedural --out runs/compact
    flowbothd train --preset paper --data path/to/partnet_mobility/train --out runs/paper
    torchrun --nproc-per-node 4 -m flowbothd_model.training.train --preset paper --out runs/paper

The same command goes on where a run was interrupted.
"""

from __future__ import annotations

import argparse
import logging
import os
from collections.abc import Sequence
from dataclasses import MISSING, fields
from pathlib import Path

import torch
from torch import distributed

from flowbothd_model.config import PRESETS
from flowbothd_model.data.procedural.catalogue import MAKERS
from flowbothd_model.data.sampling import SampleConfig, Situation
from flowbothd_model.data.splits import split_folders
from flowbothd_model.data.stream import Mixture, ObjectSource, PartNetSource, ProceduralSource
from flowbothd_model.training.train_config import TrainConfig
from flowbothd_model.training.trainer import Trainer
from flowbothd_model.training.validation import ValidationSet

CATEGORY_WEIGHTS = {"Door": 8.0, "StorageFurniture": 2.0, "Table": 1.5, "Refrigerator": 1.5}
"""Procedural doors carry their category; cabinets are most of the paper's test links."""

_HELP = {
    "out": "folder of the run",
    "preset": f"one of {', '.join(PRESETS)}",
    "data": "procedural, or a folder of PartNet-Mobility objects to mix in",
    "categories": "procedural categories, separated by commas; empty = all",
    "situations": "of closed, open, open_with_history, separated by commas",
    "steps": "optimiser steps of the whole run",
    "batch": "clouds per step and process",
    "own_histories": "share of the histories that the network predicts itself, 0 to 1",
    "draws": "noise levels per cloud",
    "rate": "peak learning rate, 0 = the preset's",
    "workers": "data processes",
    "precision": "fp32 or bf16",
    "device": "auto, cpu or cuda",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One option per field of TrainConfig."""
    for field in fields(TrainConfig):
        default = None if field.default is MISSING else field.default
        kind = Path if field.name == "out" else type(default)
        parser.add_argument(
            "--" + field.name.replace("_", "-"),
            type=kind,
            default=default,
            required=default is None,
            help=_HELP.get(field.name, "see TrainConfig"),
        )
    parser.add_argument("--threads", type=int, default=0, help="torch threads, 0 = torch's choice")


def mixtures(config: TrainConfig) -> tuple[Mixture, Mixture]:
    """Return the sources to train and to validate on."""
    shown = SampleConfig(points=config.points, robot_share=config.robot_share)
    weights = CATEGORY_WEIGHTS
    if config.categories:
        wanted = config.categories.split(",")
        unknown = sorted(set(wanted) - set(MAKERS))
        if unknown:
            raise ValueError(f"no such categories: {unknown}; there are {sorted(MAKERS)}")
        weights = {name: float(name in wanted) for name in MAKERS}
    train: list[tuple[ObjectSource, float]] = [(ProceduralSource(weights), 1.0)]
    held: list[tuple[ObjectSource, float]] = [(ProceduralSource(held_out=True), 1.0)]
    if config.data != "procedural":
        kept, held_out = split_folders(Path(config.data))
        share = config.partnet_share
        train = [(train[0][0], 1 - share), (PartNetSource(kept, stretch=0.2), share)]
        held = [(held[0][0], 0.5), (PartNetSource(held_out), 0.5)]
    situations = tuple((Situation(name), 1.0) for name in config.situations.split(","))
    validation = Mixture(tuple(held), shown, seed=config.seed + 1_000_003)
    return Mixture(tuple(train), shown, situations, config.seed), validation


def run(args: argparse.Namespace) -> int:
    """Train as the parsed arguments say; returns the exit code."""
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    config = TrainConfig(**{f.name: getattr(args, f.name) for f in fields(TrainConfig)})
    if args.threads:
        torch.set_num_threads(args.threads)
    several = int(os.environ.get("WORLD_SIZE", "1")) > 1
    if several:
        distributed.init_process_group("nccl" if torch.cuda.is_available() else "gloo")
    try:
        train, held_out = mixtures(config)
        first = int(os.environ.get("RANK", "0")) == 0
        validation = None
        if config.validate_every and first:
            validation = ValidationSet(held_out, config.validation_samples)
        trainer = Trainer(config, train, validation)
        loss = trainer.run()
        logging.getLogger(__name__).info("step %d, loss %.4f", trainer.step, loss)
    finally:
        if several:
            distributed.destroy_process_group()
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_arguments(parser)
    return run(parser.parse_args(argv))


if __name__ == "__main__":
    raise SystemExit(main())
