"""Presets and hyper-parameters; they travel inside the checkpoint."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from enum import StrEnum
from typing import Any


class Architecture(StrEnum):
    """Which network."""

    PAPER = "paper"
    COMPACT = "compact"


class Target(StrEnum):
    """Target of the network's prediction."""

    EPSILON = "epsilon"
    FLOW = "flow"


class Schedule(StrEnum):
    """Mixing of signal and noise over the steps."""

    DDPM_LINEAR = "ddpm_linear"
    STRAIGHT = "straight"
    IMPLICIT = "implicit"


class Frame(StrEnum):
    """Transformation of a cloud before it enters the network."""

    WORLD = "world"
    CENTRED = "centred"


@dataclass(frozen=True)
class DiffusionConfig:
    """The noise process.

    Attributes:
        schedule: `ddpm_linear` is the published one; `straight` mixes linearly; `implicit` has no
            chain: one step maps a small random vector to a flow (implicit.py).
        target: What is predicted.
        steps: Of the published chain; the finest grid of the straight one.
        shift: Straight only: moves the levels towards noise, where the modes part.
        reference_points: Straight only: noise grows with sqrt(N / reference_points), so that the
            mean noise of a patch of the object does not depend on how densely it was sampled.
            0 = the same noise for every N.
        angle_weight: Weight of 1 - cosine in the loss, fading out towards noise.
        hypotheses: Implicit only: flows drawn per cloud, of which the nearest learns.
    """

    schedule: Schedule = Schedule.DDPM_LINEAR
    target: Target = Target.EPSILON
    steps: int = 100
    shift: float = 1.0
    reference_points: int = 0
    angle_weight: float = 0.0
    hypotheses: int = 1

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.steps < 1:
            raise ValueError(f"steps must be at least 1, got {self.steps}")
        if self.shift <= 0:
            raise ValueError(f"shift must be positive, got {self.shift}")


@dataclass(frozen=True)
class NetworkConfig:
    """The network.

    Attributes:
        architecture: Published, or the compact one.
        width: Of the transformer.
        heads: Of the transformer.
        denoiser_layers: Blocks that run at every denoising step.
        encoder_layers: Compact only: blocks that run once per cloud.
        tokens: Compact only: patches of the current cloud.
        neighbours: Compact only: points per patch, of a cloud of 1024 points.
        history_tokens: Compact only: patches of the history.
        history: Whether there is a history encoder (off: the paper's ablation).
        latent: Compact only: size of the random vector of the implicit model, 0 = diffusion.
        diffusion: Whether there is a noisy flow to denoise (off: regression, as FlowBot3D does).
    """

    architecture: Architecture = Architecture.PAPER
    width: int = 128
    heads: int = 4
    denoiser_layers: int = 5
    encoder_layers: int = 0
    tokens: int = 0
    neighbours: int = 0
    history_tokens: int = 0
    history: bool = True
    diffusion: bool = True
    latent: int = 0

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.width % self.heads:
            raise ValueError(f"width must be a multiple of heads, got {self.width}, {self.heads}")
        if self.architecture is Architecture.COMPACT and not (
            0 < self.tokens <= 256 and 0 < self.history_tokens <= 256 and self.neighbours > 0
        ):
            raise ValueError(
                "compact needs 1..256 tokens, 1..256 history_tokens and neighbours, "
                f"got {self.tokens}, {self.history_tokens}, {self.neighbours}"
            )


@dataclass(frozen=True)
class ModelConfig:
    """Everything needed to rebuild and run a model.

    Attributes:
        name: Of the preset.
        network: The network.
        diffusion: The noise process.
        frame: What is done to the cloud first.
        sampler: Default sampler, `ddpm` or `ddim`.
        sampling_steps: Default number of steps.
    """

    name: str = "paper"
    network: NetworkConfig = field(default_factory=NetworkConfig)
    diffusion: DiffusionConfig = field(default_factory=DiffusionConfig)
    frame: Frame = Frame.WORLD
    sampler: str = "ddpm"
    sampling_steps: int = 100

    def __post_init__(self) -> None:
        """Check the sampler, and that an implicit model has its latent."""
        implicit = self.diffusion.schedule is Schedule.IMPLICIT
        if implicit != (self.network.latent > 0):
            raise ValueError(
                "the implicit schedule and a latent of at least 1 go together, got "
                f"{self.diffusion.schedule} and {self.network.latent}"
            )
        if self.sampler not in ("ddpm", "ddim"):
            raise ValueError(f"sampler must be ddpm or ddim, got {self.sampler!r}")
        if not 1 <= self.sampling_steps <= self.diffusion.steps:
            raise ValueError(
                f"sampling_steps must be in 1..{self.diffusion.steps}, got {self.sampling_steps}"
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)

    @staticmethod
    def from_dict(values: dict[str, Any]) -> ModelConfig:
        """The inverse of `to_dict`.

        Raises:
            ValueError: unknown or malformed entries.
        """
        try:
            network = _build(NetworkConfig, values["network"], architecture=Architecture)
            diffusion = _build(
                DiffusionConfig, values["diffusion"], schedule=Schedule, target=Target
            )
            rest = {k: v for k, v in values.items() if k not in ("network", "diffusion", "frame")}
            unknown = set(rest) - {f.name for f in fields(ModelConfig)}
            if unknown:
                raise ValueError(f"unknown entries {sorted(unknown)}")
            return ModelConfig(
                network=network, diffusion=diffusion, frame=Frame(values["frame"]), **rest
            )
        except (KeyError, TypeError) as error:
            raise ValueError(f"not a model configuration: {error}") from error


def _build(kind: type, values: dict[str, Any], **enums: type[StrEnum]) -> Any:
    """A configuration from plain values, with the enumerations restored."""
    return kind(**{k: enums[k](v) if k in enums else v for k, v in values.items()})


_COMPACT = NetworkConfig(
    architecture=Architecture.COMPACT,
    denoiser_layers=3,
    encoder_layers=3,
    tokens=96,
    neighbours=16,
    history_tokens=32,
)

PRESETS: dict[str, ModelConfig] = {
    "paper": ModelConfig(),
    "paper-no-history": ModelConfig("paper-no-history", NetworkConfig(history=False)),
    "paper-no-diffusion": ModelConfig(
        "paper-no-diffusion",
        NetworkConfig(diffusion=False, denoiser_layers=0),
        DiffusionConfig(target=Target.FLOW, steps=1),
        sampling_steps=1,
    ),
    "flowbot3d": ModelConfig(
        "flowbot3d",
        NetworkConfig(history=False, diffusion=False, denoiser_layers=0),
        DiffusionConfig(target=Target.FLOW, steps=1),
        sampling_steps=1,
    ),
    "compact": ModelConfig(
        "compact",
        replace(_COMPACT, latent=8),
        DiffusionConfig(Schedule.IMPLICIT, Target.FLOW, steps=1, hypotheses=8),
        Frame.CENTRED,
        "ddim",
        1,
    ),
    "compact-diffusion": ModelConfig(
        "compact-diffusion",
        _COMPACT,
        DiffusionConfig(
            Schedule.STRAIGHT,
            Target.FLOW,
            steps=100,
            shift=5.0,
            reference_points=1024,
        ),
        Frame.CENTRED,
        "ddim",
        8,
    ),
    "compact-no-history": ModelConfig(
        "compact-no-history",
        replace(_COMPACT, latent=8, history=False),
        DiffusionConfig(Schedule.IMPLICIT, Target.FLOW, steps=1, hypotheses=8),
        Frame.CENTRED,
        "ddim",
        1,
    ),
    "compact-no-diffusion": ModelConfig(
        "compact-no-diffusion",
        replace(_COMPACT, diffusion=False),
        DiffusionConfig(target=Target.FLOW, steps=1),
        Frame.CENTRED,
        sampling_steps=1,
    ),
    "compact-flowbot3d": ModelConfig(
        "compact-flowbot3d",
        replace(_COMPACT, history=False, diffusion=False),
        DiffusionConfig(target=Target.FLOW, steps=1),
        Frame.CENTRED,
        sampling_steps=1,
    ),
}
"""`flowbot3d` is PointNet++ alone; the other variants are the paper's ablations. Those of `compact`
lack the same: the draw of answers (`no-diffusion`), the history, or both (`flowbot3d`)."""
