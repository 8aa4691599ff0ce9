"""Weights in safetensors files, with the configuration inside."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from flowbothd_common.errors import CheckpointError
from flowbothd_model.config import ModelConfig
from flowbothd_model.network.factory import build
from flowbothd_model.network.network import FlowNetwork

_FORMAT = "flowbothd-1"


@dataclass(frozen=True)
class Checkpoint:
    """Contents of a file of weights.

    Attributes:
        config: Of the model.
        tensors: By name, on the CPU.
        about: Free text values, such as the training step.
    """

    config: ModelConfig
    tensors: dict[str, Tensor]
    about: dict[str, str]

    def network(self) -> FlowNetwork:
        """The network with these weights, in evaluation mode.

        Raises:
            CheckpointError: the weights do not belong to the configuration.
        """
        network = build(self.config.network)
        try:
            network.load_state_dict(self.tensors)
        except RuntimeError as error:
            raise CheckpointError(
                "the weights do not fit their configuration",
                got=str(error).splitlines()[-1].strip(),
            ) from error
        return network.eval()


def weights_hash(file: Path) -> str:
    """The sha256 of a file of weights, in hexadecimal digits."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def save_checkpoint(
    path: Path, config: ModelConfig, tensors: dict[str, Tensor], about: dict[str, str] | None = None
) -> None:
    """Write weights, atomically: a reader sees the old file or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    metadata = {
        **(about or {}),
        "format": _FORMAT,
        "config": json.dumps(config.to_dict(), sort_keys=True),
    }
    part = path.with_suffix(".part")
    save_file(
        {k: v.detach().cpu().contiguous().clone() for k, v in tensors.items()}, part, metadata
    )
    part.replace(path)


def read_checkpoint(path: Path) -> Checkpoint:
    """Read weights.

    Raises:
        CheckpointError: the file is missing, damaged, or not ours.
    """
    if not path.is_file():
        raise CheckpointError(
            f"no weights at {path}", hint="train with `flowbothd train`, or set FLOWBOTHD_MODELS"
        )
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise CheckpointError(
            f"{path} is damaged or no safetensors file", got=str(error)
        ) from error
    if metadata.get("format") != _FORMAT:
        raise CheckpointError(
            f"{path} was not written by FlowBotHD", got=metadata.get("format"), allowed=_FORMAT
        )
    try:
        config = ModelConfig.from_dict(json.loads(metadata["config"]))
    except (KeyError, ValueError) as error:
        raise CheckpointError(f"{path} has no usable configuration", got=str(error)) from error
    about = {k: v for k, v in metadata.items() if k not in ("format", "config")}
    return Checkpoint(config, tensors, about)
