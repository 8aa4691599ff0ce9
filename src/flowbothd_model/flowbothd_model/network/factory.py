"""From a configuration to a network."""

from __future__ import annotations

import torch

from flowbothd_model.config import Architecture, NetworkConfig
from flowbothd_model.network.compact import CompactNetwork
from flowbothd_model.network.network import FlowNetwork
from flowbothd_model.network.paper import PaperNetwork


def build(config: NetworkConfig, generator: torch.Generator | None = None) -> FlowNetwork:
    """The network of `config`, initialised from `generator`; the global one is left as it was."""
    seed = int(torch.randint(2**62, (1,), generator=generator)) if generator else 0
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        if config.architecture is Architecture.COMPACT:
            return CompactNetwork(config)
        return PaperNetwork(config)
