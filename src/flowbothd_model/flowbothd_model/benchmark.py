"""`flowbothd bench model`: seconds per sample next to the arithmetic floor, interleaved in one run.

The yardstick is the arithmetic of one forward pass of the published network on 1200 points,
without any geometry; one published sample of 100 steps costs 107 of them (measured side by side
with the authors' network). Ratios to it hold on any machine and under any load.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import nn

from flowbothd_common.types import Cloud, History
from flowbothd_model.config import PRESETS
from flowbothd_model.data.procedural.panels import DoorMode, four_mode_door
from flowbothd_model.data.sampling import SampleConfig, Situation, draw_sample
from flowbothd_model.network.dit import PlainBlock
from flowbothd_model.network.factory import build
from flowbothd_model.predictor import Predictor, load

FORWARDS_PER_PUBLISHED_SAMPLE = 107
POINTS = 1200


class Yardstick(nn.Module):
    """The multiplications of one published forward pass, on random numbers."""

    def __init__(self) -> None:
        super().__init__()
        sizes: list[tuple[int, ...]] = [(6, 64, 64, 128), (131, 128, 128, 256)]
        sizes += [(259, 256, 512, 1024), (1280, 256, 256), (384, 256, 128)]
        sizes += [(131, 128, 128, 128), (128, 128, 128, 128)]
        self._mlps = nn.ModuleList(_published_mlp(widths) for widths in sizes)
        self._blocks = nn.ModuleList(PlainBlock(128, 4) for _ in range(5))
        generator = torch.Generator().manual_seed(0)
        rows = (240 * 64, 60 * 64, 60, 60, 240, POINTS, POINTS)
        self._inputs = [
            torch.randn((count, widths[0]), generator=generator)
            for count, widths in zip(rows, sizes, strict=True)
        ]

    def forward(self) -> torch.Tensor:
        """(1, 1200, 128)."""
        x = torch.empty(0)
        for number, (mlp, rows) in enumerate(zip(self._mlps, self._inputs, strict=True)):
            x = mlp(rows)
            if number < 2:
                x = x.view(-1, 64, x.shape[-1]).amax(1)
        x = x[None]
        for block in self._blocks:
            x = block(x)
        return x


def _published_mlp(widths: Sequence[int]) -> nn.Sequential:
    """Linear, LeakyReLU, batch norm, as the published code runs them."""
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.LeakyReLU(), nn.BatchNorm1d(after)]
    return nn.Sequential(*layers)


def example_cloud(points: int = POINTS) -> tuple[Cloud, History]:
    """A half-open door with a history, always the same."""
    door = four_mode_door(np.random.default_rng(0), DoorMode.PULL_LEFT)
    shown = SampleConfig(points=points, robot_share=1.0, augment=False)
    sample = draw_sample(door, Situation.HISTORY, shown, np.random.default_rng(1), attempts=50)
    if sample is None or sample.history is None:
        raise RuntimeError("the example door cannot be seen")
    return sample.current.points, History(sample.history.points, sample.history.flow)


def interleaved(
    jobs: dict[str, Callable[[], object]], repeats: int, device: torch.device
) -> dict[str, list[float]]:
    """Seconds of every job, taken in turns so that a disturbance meets all of them."""
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for round_ in range(repeats + 1):
        for name, job in jobs.items():
            if device.type == "cuda":
                torch.cuda.synchronize()
            start = time.perf_counter()
            job()
            if device.type == "cuda":
                torch.cuda.synchronize()
            if round_:  # the first round warms up
                seconds[name].append(time.perf_counter() - start)
    return seconds


def measure(
    predictors: dict[str, Predictor], repeats: int, device: torch.device
) -> dict[str, dict[str, float]]:
    """Median and p99 seconds of each predictor's default setting, and ratios to the yardstick."""
    cloud, history = example_cloud()
    yardstick = Yardstick().eval()
    jobs: dict[str, Callable[[], object]] = {"yardstick": lambda: yardstick()}
    for name, predictor in predictors.items():
        for samples in (1, 20):
            if samples == 20 and predictor.config.name.startswith("paper"):
                continue
            jobs[f"{name} x{samples}"] = lambda p=predictor, n=samples: p.sample(  # type: ignore[misc]
                cloud, history, samples=n, seed=0
            )
    with torch.inference_mode():
        seconds = interleaved(jobs, repeats, device)
    published = FORWARDS_PER_PUBLISHED_SAMPLE * statistics.median(seconds["yardstick"])
    return {
        name: {
            "median_s": statistics.median(values),
            "p99_s": float(np.quantile(values, 0.99)),
            "published_sample_ratio": published / statistics.median(values),
        }
        for name, values in seconds.items()
    }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the benchmark."""
    parser.add_argument("--model", action="append", default=[], help="weights; may be repeated")
    parser.add_argument(
        "--paper",
        action="store_true",
        help="the published network too (random weights, 10 ddim steps)",
    )
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--json", type=Path, default=None, help="write the results here")


def run(args: argparse.Namespace) -> int:
    """Measure and print; returns the exit code."""
    torch.set_num_threads(args.threads)
    device = torch.device(args.device)
    predictors = {str(name): load(name, device) for name in args.model}
    if not predictors:
        config = PRESETS["compact"]
        predictors["compact (random weights)"] = Predictor(
            build(config.network), config, "random", device
        )
    if args.paper:
        config = PRESETS["paper"]
        network = build(config.network)
        predictors["paper (random weights), 100 steps"] = Predictor(
            network, config, "random", device
        )
    results = measure(predictors, args.repeats, device)
    lines = [f"{'job':44} {'median':>9} {'p99':>9} {'x published sample':>19}"]
    lines += [
        f"{name:44} {r['median_s']:8.4f}s {r['p99_s']:8.4f}s {r['published_sample_ratio']:18.1f}x"
        for name, r in results.items()
    ]
    print("\n".join(lines))  # noqa: T201 - this is the command's output
    if args.json:
        args.json.write_text(json.dumps(results, indent=2), encoding="utf-8")
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
