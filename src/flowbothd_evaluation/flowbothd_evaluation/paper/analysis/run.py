"""All analyses of the paper's experiments at once: one JSON file and their pictures."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from flowbothd_common.errors import FlowBotError
from flowbothd_evaluation.paper.analysis import (
    ANALYSES,
    chains,
    doors,
    history,
    multimodality,
    occlusion,
    recorded_clouds,
    rollouts,
    showcases,
)
from flowbothd_evaluation.paper.analysis.inputs import Inputs, MissingInputError
from flowbothd_evaluation.paper.analysis.picture import label_of
from flowbothd_evaluation.record_files import write_json

_log = logging.getLogger(__name__)

Result = tuple[dict[str, Any], list[tuple[str, str]]]
"""Plain data, and (title, file name) of the pictures that were written."""


@dataclass(frozen=True)
class _Task:
    inputs: Inputs
    out: Path
    seed: int
    small: bool
    clouds: Path | None


def run_analyses(
    partnet: Path | None,
    weights: Mapping[str, str],
    out: Path,
    *,
    seed: int = 0,
    small: bool = True,
    only: Sequence[str] = (),
    clouds: Path | None = None,
) -> dict[str, Any]:
    """Compute every analysis, and write `analyses.json` and the pictures into `out`.

    Args:
        partnet: PartNet-Mobility objects: a folder of them, or one that holds `train` and `raw`.
            None or an empty one: objects by rule where that is possible.
        weights: Method -> weights (a name under models/, a folder or a file): flowbothd,
            flowbot3d-ro and flowbot3d-md, and `diffusion` for weights with a denoising chain.
        out: Folder; made if it is missing.
        seed: Of everything.
        small: Few objects and openings, minutes; otherwise all held-out ones.
        only: Names of ANALYSES; all if empty.
        clouds: Folder with recorded clouds, or None.

    Returns:
        What analyses.json holds: for every analysis `data`, `figures` (title, file) and `seconds`,
        or `skipped` with the reason; and what was asked for.

    Raises:
        ValueError: `only` names an analysis that there is not.
    """
    unknown = sorted(set(only) - set(ANALYSES))
    if unknown:
        raise ValueError(f"no analysis called {unknown}; there are {list(ANALYSES)}")
    out.mkdir(parents=True, exist_ok=True)
    with _one_thread():
        inputs = Inputs(partnet, weights)
        results: dict[str, Any] = {
            "seed": seed,
            "small": small,
            "weights": inputs.about,
            "partnet": inputs.has_partnet,
            "analyses": {},
        }
        for name, analyse in _RUN.items():
            if only and name not in only:
                continue
            started = time.monotonic()
            try:
                data, figures = analyse(_Task(inputs, out, seed, small, clouds))
                entry: dict[str, Any] = {"data": data, "figures": figures}
            except FlowBotError as error:
                entry = {"skipped": str(error)}
            entry["seconds"] = round(time.monotonic() - started, 1)
            _log.info("%s: %s s", name, entry["seconds"])
            results["analyses"][name] = entry
            write_json(out / "analyses.json", results)
    return results


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread for torch: the same sums everywhere, and no waiting on a busy machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _occlusion(task: _Task) -> Result:
    predictors = task.inputs.compared()
    settings = task.inputs.occluded(task.small)
    data = occlusion.occlusion(
        settings,
        predictors,
        samples=4 if task.small else 20,
        remembering=task.inputs.remembering,
        seed=task.seed,
    )
    occlusion.draw_occlusion(data, task.out / "occlusion.png")
    # Three rows are what a reader can compare.
    occlusion.draw_occluded_flows(settings[:3], predictors, data, task.out / "occlusion_flows.png")
    return data, [
        ("Errors against open ratio under occlusion", "occlusion.png"),
        ("Flows where the part is hidden most", "occlusion_flows.png"),
    ]


def _multimodality(task: _Task) -> Result:
    settings = task.inputs.closed(task.small)
    data = multimodality.multimodality(settings, task.inputs.compared(), seed=task.seed)
    multimodality.draw_multimodality(data, task.out / "multimodality.png")
    return data, [("Multi-modality of closed objects", "multimodality.png")]


def _doors(task: _Task) -> Result:
    ratios = (0.0, 0.05, 0.25, 0.5, 0.75, 1.0) if task.small else np.linspace(0, 1, 21).tolist()
    data = doors.closed_and_open(
        task.inputs.doors(task.small),
        task.inputs.compared(),
        ratios=ratios,
        remembering=task.inputs.remembering,
        seed=task.seed,
    )
    data["table"] = doors.markdown_closed_and_open(data)
    doors.draw_closed_and_open(data, task.out / "doors.png")
    return data, [("Closed and open doors", "doors.png")]


def _history(task: _Task) -> Result:
    predictor = task.inputs.main()
    cases = [(s, ratio) for s in task.inputs.half_open(task.small) for ratio in (0.3, 0.6)]
    data = history.history_filter(
        cases, predictor, samples=30 if task.small else 50, seed=task.seed
    )
    if not data["clouds"]:
        raise MissingInputError("no cloud had a good and a bad first prediction")
    told = {(cloud["object"], cloud["ratio"]) for cloud in data["clouds"]}
    shown = next(case for case in cases if (label_of(case[0].item), case[1]) in told)
    history.draw_history_filter(data, shown, predictor, task.out / "history.png")
    return data, [("What the history does to the next prediction", "history.png")]


def _chains(task: _Task) -> Result:
    door = chains.AmbiguousDoor.make(task.seed)
    data: dict[str, Any] = {}
    figures = []
    for name, file in (("flowbothd", "chains.png"), ("diffusion", "denoising.png")):
        try:
            checkpoint = task.inputs.checkpoint(name)
            data[name], found = chains.chains(checkpoint, door, seed=task.seed)
        except (MissingInputError, ValueError) as error:
            data[name] = {"skipped": str(error)}
            continue
        chains.draw_chains(data[name], found, door, task.out / file)
        what = "Denoising" if name == "diffusion" else "From chance to an answer"
        figures.append((f"{what}: one closed door, several modes", file))
    if not figures:
        raise MissingInputError("; ".join(str(part["skipped"]) for part in data.values()))
    return data, figures


def _rollouts(task: _Task) -> Result:
    models = task.inputs.rollout_models()
    data, runs = rollouts.rollouts(
        models, task.inputs.main(), range(task.seed, task.seed + (3 if task.small else 10))
    )
    figures = []
    for number, (model, record) in enumerate(rollouts.telling_runs(runs)):
        file = f"rollout_{number}.png"
        rollouts.draw_rollout(model, record, task.out / file)
        kind = "a laborious one" if number else "a smooth one"
        figures.append((f"A run of the policy, {kind}", file))
    return data, figures


def _showcases(task: _Task) -> Result:
    data, found = showcases.showcases(
        task.inputs.ambiguous(task.seed), task.inputs.main(), seed=task.seed
    )
    showcases.draw_showcases(found, task.seed, task.out / "showcases.png")
    return data, [("Objects whose opening cannot be seen", "showcases.png")]


def _recorded_clouds(task: _Task) -> Result:
    if task.clouds is None:
        raise MissingInputError("no folder of recorded clouds was given")
    predictor = task.inputs.main()
    recorded = recorded_clouds.read_recorded(task.clouds)
    recorded_clouds.draw_recorded(recorded, predictor, task.out / "recorded_clouds.png")
    clouds = [
        {"name": one.name, "measured": one.measured, "sampled": len(one.points)} for one in recorded
    ]
    data = {"what": "samples of the flow on clouds that were recorded", "clouds": clouds}
    return data, [("Recorded clouds and samples of their flow", "recorded_clouds.png")]


_RUN: dict[str, Callable[[_Task], Result]] = dict(
    zip(
        ANALYSES,
        (
            *(_occlusion, _multimodality, _doors, _history, _chains),
            *(_rollouts, _showcases, _recorded_clouds),
        ),
        strict=True,
    )
)
