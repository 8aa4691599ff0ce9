"""Parameters of the inference node."""

from __future__ import annotations

from dataclasses import dataclass

from flowbothd_common.parameters import parameter


@dataclass(frozen=True)
class InferenceParams:
    """Weights, and how they are used."""

    model_path: str = parameter("", "name, folder or file of the weights")
    device: str = parameter("cpu", "where the network runs, such as cpu or cuda:0")
    steps: int = parameter(
        0, "denoising steps; 0 = the model's own choice", minimum=0, maximum=10000
    )
    sampler: str = parameter("", "sampler of the diffusion model; empty = the model's own choice")
    cloud_scale: float = parameter(
        1.0,
        "clouds and histories are multiplied by this before the network; the paper took 3 for its "
        "small door",
        minimum=0.01,
        maximum=100.0,
    )
    max_samples: int = parameter(
        1000, "largest number of samples in one request", minimum=1, maximum=1000000
    )
    autostart: bool = parameter(True, "configure and activate by itself")
