"""Parameters of the inference node."""

from __future__ import annotations

from dataclasses import dataclass

from flowbothd_common.parameters import parameter


@dataclass(frozen=True)
class InferenceParams:
    """Source and settings of the predictions."""

    predictor: str = parameter(
        "oracle",
        "oracle: the simulation's true flow with noise; ambiguous: like a network that does not "
        "know how a closed part opens; model: a trained network",
        choices=("oracle", "ambiguous", "model"),
    )
    model_path: str = parameter("", "folder or file of the weights; needed by predictor model")
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
    noise: float = parameter(
        0.05,
        "oracles: standard deviation of each point's own error, per component of max-normalised "
        "flow",
        minimum=0.0,
        maximum=10.0,
    )
    tilt: float = parameter(
        0.05,
        "oracles: standard deviation of a rotation common to all points of a sample [rad]",
        minimum=0.0,
        maximum=3.2,
    )
    wrong_mode_probability: float = parameter(
        0.2,
        "ambiguous: probability of a wrong way of opening once the part is visibly open",
        minimum=0.0,
        maximum=1.0,
    )
    open_threshold: float = parameter(
        0.05, "ambiguous: open ratio from which the part is visibly open", minimum=0.0, maximum=1.0
    )
    truth_timeout: float = parameter(
        5.0, "oracles: wait for the simulation's answer [s]", minimum=0.1, maximum=600.0
    )
    max_samples: int = parameter(
        1000, "largest number of samples in one request", minimum=1, maximum=1000000
    )
    autostart: bool = parameter(True, "configure and activate without a request")
