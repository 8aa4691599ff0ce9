"""How one closed door's predictions come about, and end in different modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from torch import Tensor

from flowbothd_common.types import Cloud
from flowbothd_evaluation.paper.analysis.measure import Plain, rounded, seed_of
from flowbothd_evaluation.paper.analysis.picture import Portrait
from flowbothd_evaluation.paper.analysis.setting import Setting, setting_of
from flowbothd_evaluation.paper.figures.style import save, tidy
from flowbothd_model.checkpoint import Checkpoint
from flowbothd_model.data.articulated import ArticulatedObject, flow_of, max_normalised
from flowbothd_model.data.observation import Observation
from flowbothd_model.data.procedural.catalogue import HELD_OUT_FROM
from flowbothd_model.data.procedural.panels import DoorMode, four_mode_door
from flowbothd_model.frames import max_normalised as normalised
from flowbothd_model.network.diffusion import Diffusion
from flowbothd_model.network.implicit import LEVEL
from flowbothd_model.network.network import Context, FlowNetwork
from flowbothd_model.network.sampler import SAMPLERS, encode_batch
from flowbothd_model.predictor import canonical_order

MODES = {
    DoorMode.PULL_LEFT: ("pull, hinge left", "#0072b2"),
    DoorMode.PULL_RIGHT: ("pull, hinge right", "#56b4e9"),
    DoorMode.PUSH_LEFT: ("push, hinge left", "#d55e00"),
    DoorMode.PUSH_RIGHT: ("push, hinge right", "#e69f00"),
}
"""Mode -> its name in words and its colour."""

CLEAR = 0.75
"""Agreement with a mode from which a field counts as showing it."""


@dataclass(frozen=True)
class AmbiguousDoor:
    """A closed door that may open in four ways, and the flow of each.

    Attributes:
        setting: The door, in its first mode.
        seen: The closed door's cloud.
        flows: (4, N, 3) true flows, in the order of MODES.
    """

    setting: Setting
    seen: Observation
    flows: Cloud

    @staticmethod
    def make(seed: int) -> AmbiguousDoor:
        """A held-out door of the paper's kind, with every measure varied.

        Raises:
            ValueError: the door cannot be seen.
        """

        def door(mode: DoorMode) -> ArticulatedObject:
            rng = np.random.default_rng([HELD_OUT_FROM + seed, 3])
            return four_mode_door(rng, mode, "four-mode door", jitter=0.25)

        doors = [door(mode) for mode in MODES]
        setting = setting_of(doors[0], azimuth=75.0, elevation=35.0)
        seen = setting.see(0.0, seed)
        if seen is None:
            raise ValueError(f"the ambiguous door of seed {seed} cannot be seen")
        flows = [
            max_normalised(flow_of(d.opening_twists(d.closed()), seen.link, seen.points))
            for d in doors
        ]
        return AmbiguousDoor(setting, seen, np.stack(flows))

    def agreement(self, flows: Tensor) -> np.ndarray:
        """(S, 4) agreement of (S, N, 3) flows with each mode: cosine of the whole fields, -1 to 1.

        Of the whole field and not point by point: on a closed door every point moves straight out
        or in, wherever the hinge is; only the lengths tell the left from the right.
        """
        given = flows.flatten(1).numpy().astype(float)
        modes = self.flows.reshape(len(self.flows), -1).astype(float)
        lengths = np.linalg.norm(given, axis=1)[:, None] * np.linalg.norm(modes, axis=1)
        return np.asarray(given @ modes.T / np.maximum(lengths, 1e-9))


@dataclass(frozen=True)
class Chains:
    """Fields on the way from chance to an answer.

    Attributes:
        axis: What changes along the way, in words.
        places: (K,) where on the way.
        fields: (C, K, N, 3) float32, max-normalised; C ways.
        agreement: (C, K, 4) with each mode.
    """

    axis: str
    places: np.ndarray
    fields: Cloud
    agreement: np.ndarray


def chains(
    checkpoint: Checkpoint, door: AmbiguousDoor, *, tries: int = 32, seed: int = 0
) -> tuple[Plain, Chains]:
    """The ways to different modes: of a denoising chain, or between two random vectors.

    A diffusion model is followed through its chain, from several draws of noise. A model of one
    step has no chain: it is followed along the arc from one random vector to another that ends in
    another mode, with every field a full answer.

    Args:
        checkpoint: Weights with their configuration.
        door: The door.
        tries: Draws among which different modes are looked for.
        seed: Of the draws.

    Raises:
        ValueError: the model draws nothing, so that every answer is the same.
    """
    config = checkpoint.config
    if not config.network.latent and not config.network.diffusion:
        raise ValueError(f"{config.name} draws nothing: it has one answer for a cloud")
    network = checkpoint.network()
    order = canonical_order(door.seen.points)
    with torch.inference_mode():
        points = torch.from_numpy(door.seen.points[order])[None]
        context = encode_batch(network, config, points, None, None, torch.tensor([False]))
        generator = torch.Generator().manual_seed(seed_of(seed, 5))
        if config.network.latent:
            found = _between(network, context, config.network.latent, door, order, tries, generator)
        else:
            found = _denoised(network, context, checkpoint, door, order, tries, generator)
    names = [mode.value for mode in MODES]
    data = {
        "what": "agreement (cosine of the whole field) with each of the four modes of one closed "
        "door, along the way to an answer; along: " + found.axis,
        "model": f"{config.name}, {config.sampling_steps} step" + "s" * (config.sampling_steps > 1),
        "tries": tries,
        "seed": seed,
        "modes": names,
        "places": rounded(found.places),
        "ends": [names[int(row[-1].argmax())] for row in found.agreement],
        "starts": [names[int(row[0].argmax())] for row in found.agreement],
        "agreement": [[rounded(step) for step in row] for row in found.agreement],
    }
    return data, found


def _restored(fields: Tensor, order: np.ndarray) -> Tensor:
    """(..., N, 3) max-normalised fields in the cloud's own order."""
    result = torch.empty_like(fields)
    result[..., torch.from_numpy(order), :] = normalised(fields)
    return result


def _distinct(agreement: np.ndarray, most: int) -> list[int]:
    """Draws that end in different modes: of each mode the one that is least like any other mode.

    Modes that no draw agrees with by CLEAR are left out, unless nothing is clear.
    """
    ordered = np.sort(agreement, axis=1)
    mode, margin = agreement.argmax(1), ordered[:, -1] - ordered[:, -2]
    clear = ordered[:, -1] > CLEAR
    if len(np.unique(mode[clear])) < 2:
        clear[:] = True
    best = []
    for wanted in np.unique(mode[clear]):
        own = np.flatnonzero(clear & (mode == wanted))
        best.append(int(own[margin[own].argmax()]))
    return sorted(best, key=lambda index: -margin[index])[:most]


def _denoised(
    network: FlowNetwork,
    context: Context,
    checkpoint: Checkpoint,
    door: AmbiguousDoor,
    order: np.ndarray,
    tries: int,
    generator: torch.Generator,
) -> Chains:
    """Chains of a diffusion model, every noisy field kept, that end in different modes."""
    config = checkpoint.config
    kept: list[Tensor] = []
    levels: list[float] = []
    repeated = context.repeated(tries)

    def denoise(noisy: Tensor, level: Tensor) -> Tensor:
        kept.append(noisy.clone())
        levels.append(float(level[0]))
        return network.denoise(repeated, noisy, level.to(noisy.dtype) * config.diffusion.steps)

    noise = torch.randn((tries, len(order), 3), generator=generator)
    last = Diffusion(config.diffusion).sample(
        denoise, noise, config.sampling_steps, SAMPLERS[config.sampler], generator
    )
    chosen = _distinct(door.agreement(_restored(last, order)), 4)
    fields = torch.stack([*kept, last], dim=1)[chosen]  # (C, K, N, 3)
    restored = _restored(fields, order)
    agreement = np.stack([door.agreement(way) for way in restored])
    places = 1.0 - np.array([*levels, 0.0])
    return Chains("share of the denoising that is done", places, restored.numpy(), agreement)


def _between(
    network: FlowNetwork,
    context: Context,
    latent: int,
    door: AmbiguousDoor,
    order: np.ndarray,
    tries: int,
    generator: torch.Generator,
) -> Chains:
    """Arcs between random vectors that end in different modes, of a model of one step."""

    def ask(vectors: Tensor) -> Tensor:
        level = torch.full((len(vectors),), LEVEL)
        return _restored(network.denoise(context, vectors, level), order)

    vectors = torch.randn((tries, latent), generator=generator)
    chosen = _distinct(door.agreement(ask(vectors)), 4)
    # From the clearest to each of the others; if all answers are alike, to one of them.
    pairs = [(chosen[0], other) for other in chosen[1:]] or [(0, 1)]
    places = np.linspace(0, 1, 31)
    fields = [ask(_arc(vectors[a], vectors[b], places)) for a, b in pairs]
    agreement = np.stack([door.agreement(way) for way in fields])
    return Chains(
        "way from one random vector to another", places, torch.stack(fields).numpy(), agreement
    )


def _arc(start: Tensor, end: Tensor, places: np.ndarray) -> Tensor:
    """(K, D) vectors on the great arc, lengths blended: as likely as the ends, not shorter."""
    one, other = start / start.norm(), end / end.norm()
    angle = torch.arccos((one @ other).clamp(-1 + 1e-6, 1 - 1e-6))
    t = torch.from_numpy(places).to(start.dtype)[:, None]
    direction = (torch.sin((1 - t) * angle) * one + torch.sin(t * angle) * other) / angle.sin()
    blended: Tensor = direction * ((1 - t) * start.norm() + t * end.norm())
    return blended


def draw_chains(data: Plain, found: Chains, door: AmbiguousDoor, path: Path) -> None:
    """One row a way: fields at some places, and the cosine with each mode along all of it."""
    ways = found.fields[:3]
    shown = _places(len(found.places), 6)
    figure, axes = plt.subplots(
        len(ways),
        len(shown) + 1,
        figsize=(1.75 * len(shown) + 3.9, 1.95 * len(ways) + 1.0),
        width_ratios=[1] * len(shown) + [1.9],
        squeeze=False,
        layout="constrained",
    )
    portrait = Portrait(door.setting, (0.0,))
    for number, (line, way) in enumerate(zip(axes, ways, strict=True)):
        agreement = found.agreement[number]
        for axis, k in zip(line, shown, strict=False):
            best = list(MODES.values())[int(agreement[k].argmax())]
            clear = agreement[k].max() > CLEAR
            title = f"{found.places[k]:.0%}: " + (best[0] if clear else "no clear mode")
            colour = best[1] if clear else "#666666"
            portrait.draw(axis, 0.0, door.seen.points, way[k], colour)
            axis.set_title(title, fontsize=7.5)
        for mode, (words, colour) in enumerate(MODES.values()):
            line[-1].plot(found.places, agreement[:, mode], color=colour, lw=1.8, label=words)
        line[-1].set(ylim=(-1.05, 1.05), xlim=(0, 1))
        line[-1].set_ylabel("agreement with\neach mode", fontsize=8)
        line[-1].xaxis.set_major_formatter(mpl.ticker.PercentFormatter(1.0))
        tidy(line[-1])
    axes[-1, -1].set_xlabel(found.axis, fontsize=8)
    handles, labels = axes[0, -1].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(MODES), frameon=False, fontsize=9
    )
    figure.suptitle(f"One closed door, several modes: {found.axis} ({data['model']})", fontsize=12)
    save(figure, path)


def _places(count: int, most: int) -> Sequence[int]:
    """Indices spread over the way, both ends included."""
    return [int(place) for place in np.unique(np.linspace(0, count - 1, most).round())]
