"""The model as its users see it: clouds in metres in, max-normalised flows out."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from flowbothd_common.errors import CheckpointError, InvalidCloudError
from flowbothd_common.types import Cloud, History, as_cloud
from flowbothd_model.checkpoint import read_checkpoint
from flowbothd_model.config import ModelConfig
from flowbothd_model.network.network import FlowNetwork
from flowbothd_model.network.sampler import encode_batch, sample_flows

MIN_POINTS = 256
"""Fewest points of a cloud, and of a history."""

_SHARE = Path("share", "flowbothd_model", "models")
"""Where an installation has the weights, below its prefix."""

Flows = NDArray[np.float32]


class Predictor:
    """A network ready to be asked.

    Args:
        network: In evaluation mode.
        config: Of the model.
        model_id: For records, e.g. `compact-procedural@7000`.
        device: Where to compute.
    """

    def __init__(
        self,
        network: FlowNetwork,
        config: ModelConfig,
        model_id: str,
        device: torch.device | str = "cpu",
    ) -> None:
        self.config = config
        self.model_id = model_id
        self._device = torch.device(device)
        self._network = network.to(self._device).eval()

    def sample(
        self,
        points: Cloud,
        history: History | None = None,
        samples: int = 1,
        steps: int | None = None,
        sampler: str | None = None,
        seed: int | None = None,
    ) -> Flows:
        """Draw flows.

        The answer depends on the points as a set, not on their order, and on the seed.

        Args:
            points: (N, 3) [m], base frame, N >= 256. Models with the frame `centred` centre and
                scale the cloud themselves, so that any `cloud_scale` gives the same answer; those
                with the frame `world` take it as it is, where the caller's `cloud_scale` matters.
            history: The last observation and motion; treated the same way.
            samples: How many.
            steps: Denoising steps; None = the model's own choice.
            sampler: `ddpm` or `ddim`; None = the model's own choice.
            seed: None = unpredictable.

        Returns:
            (samples, N, 3) float32, each with a largest norm of 1.

        Raises:
            InvalidCloudError: too few points, not (N, 3), or not finite.
            ValueError: `samples`, `steps` or `sampler` out of range.
        """
        cloud = as_cloud(points, "cloud", min_points=MIN_POINTS)
        if samples < 1:
            raise ValueError(f"samples must be at least 1, got {samples}")
        if not np.ptp(cloud, axis=0).any():
            raise InvalidCloudError("all points of the cloud coincide", got=cloud[0].tolist())
        order = canonical_order(cloud)
        with torch.inference_mode():
            past, past_flow, present = self._history(history)
            context = encode_batch(
                self._network, self.config, self._tensor(cloud[order]), past, past_flow, present
            )
            chosen = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
            flows = sample_flows(
                self._network, self.config, context, samples, chosen, sampler, steps
            )
        result = np.empty((samples, len(cloud), 3), dtype=np.float32)
        result[:, order] = flows.cpu().numpy()
        return result

    def _history(
        self, history: History | None
    ) -> tuple[torch.Tensor | None, torch.Tensor | None, torch.Tensor]:
        if history is None:
            return None, None, torch.tensor([False], device=self._device)
        past = as_cloud(history.points, "history", min_points=MIN_POINTS)
        order = canonical_order(past)
        present = torch.tensor([True], device=self._device)
        return self._tensor(past[order]), self._tensor(history.flow[order]), present

    def _tensor(self, array: Cloud) -> torch.Tensor:
        return torch.from_numpy(array)[None].to(self._device)


def canonical_order(cloud: Cloud) -> NDArray[np.int64]:
    """(N,) indices that sort a cloud: the same order for every shuffling.

    Sorted by coordinates, then shuffled by a fixed seed, since the published network keeps the
    first 64 neighbours by index and expects these to be a random choice.
    """
    by_place = np.lexsort(cloud.T[::-1])
    return np.asarray(by_place[np.random.default_rng(0).permutation(len(cloud))])


def load(path: str | Path, device: torch.device | str = "cpu") -> Predictor:
    """The predictor of a file of weights.

    Args:
        path: A safetensors file, a folder with `model.safetensors`, or the name of a folder in
            the places that `find_weights` searches.
        device: Where to compute.

    Raises:
        CheckpointError: no such weights, or the file is damaged or not ours.
    """
    file = find_weights(path)
    checkpoint = read_checkpoint(file)
    step = checkpoint.about.get("step", "?")
    name = file.parent.name if file.name == "model.safetensors" else file.stem
    return Predictor(checkpoint.network(), checkpoint.config, f"{name}@{step}", device)


def find_weights(path: str | Path) -> Path:
    """Find a model: as given, in FLOWBOTHD_MODELS, the installed share, or the repository.

    Raises:
        CheckpointError: nowhere; the message lists the places.
    """
    given = Path(path)
    roots = [Path(v) for v in (os.environ.get("FLOWBOTHD_MODELS"),) if v]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    roots += [Path(prefix) / _SHARE for prefix in prefixes if prefix]
    package = Path(__file__).resolve().parent
    if (package.parent / "package.xml").is_file():
        roots.append(package.parent / "models")
    else:
        roots += [folder / _SHARE for folder in package.parents if (folder / _SHARE).is_dir()]
    for candidate in [given, *(root / given for root in roots)]:
        if candidate.is_file():
            return candidate
        if (candidate / "model.safetensors").is_file():
            return candidate / "model.safetensors"
    raise CheckpointError(
        f"no weights called {str(path)!r}",
        got=[str(root) for root in [given, *roots]],
        hint="train with `flowbothd train`, or set FLOWBOTHD_MODELS to the folder that holds them",
    )
