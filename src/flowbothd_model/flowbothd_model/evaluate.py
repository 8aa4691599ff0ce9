"""`python -m flowbothd_model.evaluate`: the paper's offline scores on held-out objects.

Every object is seen closed, opened without history, and opened with history, in both camera
presets; 20 samples per cloud. Reported per category and over all clouds, together with how many of
the four ways to open the ambiguous door 50 samples find.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from flowbothd_common.markdown import markdown_table
from flowbothd_common.types import Cloud, History
from flowbothd_model.data.articulated import ArticulatedObject, flow_of, max_normalised
from flowbothd_model.data.camera import robot_view
from flowbothd_model.data.observation import Observation, observe
from flowbothd_model.data.partnet import load_partnet
from flowbothd_model.data.procedural.catalogue import HELD_OUT_FROM, MAKERS, make
from flowbothd_model.data.procedural.panels import DoorMode, four_mode_door
from flowbothd_model.data.sampling import Sample, SampleConfig, Situation, draw_sample
from flowbothd_model.data.splits import split_folders
from flowbothd_model.metrics import FlowErrors, flow_errors
from flowbothd_model.predictor import Flows, Predictor, load

COVERED = 0.9
"""Cosine of the whole field from which a sample counts as one of the door's modes. A left and a
right hinge agree by 0.5, and a leaf that moves evenly by 0.87 with each. (By point it is all 1.)"""

Asked = Callable[[Cloud, History | None, int, int], Flows]
"""(points, history, samples, seed) -> flows."""


@dataclass(frozen=True)
class Scores:
    """Means over clouds.

    Attributes:
        clouds: How many.
        wta_cosine: Cosine of the best sample.
        wta_mean_error: Mean error norm of the best sample.
        wta_rmse: Root mean square error of the best sample.
        wta_magnitude: Magnitude error of the best sample.
        mean_cosine: Cosine of all samples.
        wrong_share: Samples with a negative mean cosine.
        multimodal: Clouds with right and wrong samples, by the paper's rule.
    """

    clouds: int
    wta_cosine: float
    wta_mean_error: float
    wta_rmse: float
    wta_magnitude: float
    mean_cosine: float
    wrong_share: float
    multimodal: float

    @staticmethod
    def of(errors: Sequence[FlowErrors]) -> Scores:
        """Means over some clouds."""

        def mean(values: Iterable[float]) -> float:
            return float(np.mean(list(values)))

        return Scores(
            len(errors),
            mean(float(e.cosine[e.winner]) for e in errors),
            mean(float(e.mean_error[e.winner]) for e in errors),
            mean(float(e.rmse[e.winner]) for e in errors),
            mean(float(e.magnitude[e.winner]) for e in errors),
            mean(float(e.cosine.mean()) for e in errors),
            mean(e.wrong_share for e in errors),
            mean(float(e.multimodal) for e in errors),
        )


def held_out_clouds(
    objects: Sequence[ArticulatedObject], views: int, points: int, seed: int
) -> list[Sample]:
    """Each object in every situation, `views` times; robot and published camera in turn."""
    clouds = []
    for number, item in enumerate(objects):
        for k, situation in enumerate(Situation):
            for view in range(views):
                shown = SampleConfig(
                    points=points,
                    robot_share=float(view % 2),
                    arm_share=0.0,
                    table_share=0.0,
                    max_step=0.2,
                    history_tilt=0.0,
                    augment=False,
                )
                rng = np.random.default_rng([seed, number, k, view])
                sample = draw_sample(item, situation, shown, rng)
                if sample is not None:
                    clouds.append(sample)
    return clouds


def history_of(sample: Sample) -> History | None:
    """The history of a sample as the predictor takes it."""
    past = sample.history
    return History(past.points, past.flow) if past is not None else None


def evaluate(ask: Asked, clouds: Sequence[Sample], samples: int) -> dict[str, dict[str, Scores]]:
    """Scores by situation and category; the category "all" holds every cloud."""
    rows: list[tuple[Sample, FlowErrors]] = []
    for number, cloud in enumerate(tqdm(clouds, unit="cloud", mininterval=5.0)):
        flows = ask(cloud.current.points, history_of(cloud), samples, number)
        truth = torch.from_numpy(cloud.current.flow)
        rows.append((cloud, flow_errors(torch.from_numpy(flows), truth)))
    result: dict[str, dict[str, Scores]] = {}
    for situation in Situation:
        own = [(c, e) for c, e in rows if c.situation is situation]
        names = ["all", *sorted({c.category for c, _ in own})]
        result[situation] = {
            name: Scores.of([e for c, e in own if name in ("all", c.category)]) for name in names
        }
    return result


def mode_flows(seed: int, points: int, jitter: float = 0.25) -> tuple[Observation, Cloud] | None:
    """A closed ambiguous door and (4, N, 3) flows of its modes; None if the view fails."""
    rng = np.random.default_rng([seed, 7])
    doors = [
        four_mode_door(np.random.default_rng([seed, 3]), mode, jitter=jitter) for mode in DoorMode
    ]
    first = doors[0]
    low, high = first.vertices.min(0).astype(float), first.vertices.max(0).astype(float)
    seen = observe(first, first.closed(), robot_view(rng, low, high), points, rng)
    if seen is None:
        return None
    flows = [
        max_normalised(flow_of(d.opening_twists(d.closed()), seen.link, seen.points)) for d in doors
    ]
    return seen, np.stack(flows)


def mode_coverage(ask: Asked, doors: int, samples: int, points: int) -> dict[str, float]:
    """Share of the four modes that `samples` samples find, and how evenly, over some doors."""
    found, best, counts = [], [], np.zeros(4)
    for door in range(doors):
        view = mode_flows(HELD_OUT_FROM + door, points)
        if view is None:
            continue
        seen, modes = view
        flows = torch.from_numpy(ask(seen.points, None, samples, door))
        cosines = torch.stack(
            [flow_errors(flows, torch.from_numpy(mode)).field for mode in modes]
        )  # (4, S)
        found.append(float((cosines.amax(1) > COVERED).float().mean()))
        best.append(float(cosines.amax(1).mean()))
        counts += np.bincount(cosines.argmax(0).numpy(), minlength=4)
    return {
        "doors": float(len(found)),
        "modes_covered": float(np.mean(found)),
        "best_cosine_per_mode": float(np.mean(best)),
        "rarest_mode_share": float(counts.min() / counts.sum()),
    }


def markdown(scores: dict[str, dict[str, Scores]]) -> str:
    """One table per situation."""
    columns = {
        "clouds": "clouds",
        "wta_cosine": "WTA cosine",
        "wta_mean_error": "WTA mean error",
        "wta_rmse": "WTA RMSE",
        "wta_magnitude": "WTA magnitude",
        "mean_cosine": "mean cosine",
        "wrong_share": "wrong samples",
        "multimodal": "multi-modal",
    }
    lines = []
    for situation, by_category in scores.items():
        lines.append(f"\n**{situation.replace('_', ' ')}**\n")
        rows = [
            (name, *(f"{vars(row)[c]:.3f}" if c != "clouds" else str(row.clouds) for c in columns))
            for name, row in by_category.items()
        ]
        lines.append(markdown_table(("category", *columns.values()), rows))
    return "\n".join(lines)


def asking(predictor: Predictor, steps: int | None, sampler: str | None) -> Asked:
    """The predictor with its sampler fixed."""

    def ask(points: Cloud, history: History | None, samples: int, seed: int) -> Flows:
        return predictor.sample(points, history, samples, steps, sampler, seed)

    return ask


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the evaluation."""
    parser.add_argument("model", help="weights: a file, a folder, or a name under models/")
    parser.add_argument(
        "--data",
        type=Path,
        default=None,
        help="PartNet-Mobility folder: its held-out objects; else procedural ones",
    )
    parser.add_argument("--views", type=int, default=2, help="views per object and situation")
    parser.add_argument("--objects", type=int, default=4, help="procedural objects per category")
    parser.add_argument("--samples", type=int, default=20)
    parser.add_argument(
        "--doors", type=int, default=10, help="ambiguous doors for the mode coverage"
    )
    parser.add_argument("--points", type=int, default=1200)
    parser.add_argument("--steps", type=int, default=None)
    parser.add_argument("--sampler", default=None)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--json", type=Path, default=None)


def run(args: argparse.Namespace) -> int:
    """Evaluate and print tables; returns the exit code."""
    if args.threads:
        torch.set_num_threads(args.threads)
    predictor = load(args.model, args.device)
    ask = asking(predictor, args.steps, args.sampler)
    if args.data is not None:
        objects = [load_partnet(folder) for folder in split_folders(args.data)[1]]
    else:
        objects = [make(c, HELD_OUT_FROM + k) for c in sorted(MAKERS) for k in range(args.objects)]
    scores = evaluate(ask, held_out_clouds(objects, args.views, args.points, 0), args.samples)
    coverage = mode_coverage(ask, args.doors, 50, args.points) if args.doors else {}
    text = f"{predictor.model_id}\n{markdown(scores)}\n\n{json.dumps(coverage)}"
    print(text)  # noqa: T201 - this is the command's output
    if args.json is not None:
        plain = {s: {c: vars(v) for c, v in by.items()} for s, by in scores.items()}
        record = {"model": predictor.model_id, "scores": plain, "modes": coverage}
        args.json.write_text(json.dumps(record, indent=1), encoding="utf-8")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    return run(parser.parse_args(argv))


if __name__ == "__main__":
    raise SystemExit(main())
