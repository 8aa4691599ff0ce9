"""The network of the paper: PointNet++ over points and noisy flow, history by products, then a DiT.

Sizes: facts about the published code, held by test_paper_network.py. Differences, all of them
deliberate: the farthest-point choice starts at a fixed point, so that the network is a function;
geometry and history are computed once per cloud and shared by all steps and samples; the unused
label table is left out. The projections of the history start as Xavier with bias one, so that the
products begin near the identity instead of near zero.

The regressors (FlowBot3D; ours without diffusion) are the same encoder with a linear read-out.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from flowbothd_model.config import NetworkConfig
from flowbothd_model.network.dit import AdaptiveBlock, AdaptiveOutput, LevelEmbedding, initialise
from flowbothd_model.network.network import Context, FlowNetwork, HistoryBatch
from flowbothd_model.network.pointnet2 import (
    CloudGeometry,
    FeaturePropagation,
    GlobalAbstraction,
    HistoryEncoder,
    Level,
    SetAbstraction,
    cloud_geometry,
)

_HISTORY = 128
_PRODUCTS = (1024, 256, 128, 128)


class PaperNetwork(FlowNetwork):
    """See the module."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        width = config.width
        self.config = config
        self.sa1 = SetAbstraction((6, 64, 64, 128))
        self.sa2 = SetAbstraction((131, 128, 128, 256))
        self.sa3 = GlobalAbstraction((259, 256, 512, 1024))
        self.fp3 = FeaturePropagation((1280, 256, 256))
        self.fp2 = FeaturePropagation((384, 256, 128))
        self.fp1 = FeaturePropagation((131, 128, 128, 128))
        self.head = nn.ModuleList(
            nn.Linear(a, b) for a, b in ((128, 128), (128, 128), (128, width))
        )
        if config.history:
            self.history = HistoryEncoder(_HISTORY)
            self.products = nn.ModuleList(nn.Linear(_HISTORY, size) for size in _PRODUCTS)
        if config.diffusion:
            self.level = LevelEmbedding(width)
            self.blocks = nn.ModuleList(
                AdaptiveBlock(width, config.heads) for _ in range(config.denoiser_layers)
            )
            self.output = AdaptiveOutput(width, 6)
        else:
            self.read_out = nn.Linear(width, 3)
        initialise(self)
        if config.history:
            nn.init.normal_(self.history.start)
            for product in self.products:
                nn.init.ones_(product.bias)  # type: ignore[arg-type]

    def encode(self, points: Tensor, history: HistoryBatch | None) -> Context:
        """Geometry of the points and factors of the history: (B, N, 3) -> context."""
        geometry = cloud_geometry(points)
        tensors: dict[str, Tensor | None] = {"points": points}
        for name, level in zip(("first", "second"), geometry.levels, strict=True):
            for field in ("centres", "index", "valid", "offset"):
                tensors[f"{name}_{field}"] = getattr(level, field)
        tensors["up2_weights"], tensors["up2_index"] = geometry.up2
        tensors["up1_weights"], tensors["up1_index"] = geometry.up1
        if self.config.history:
            z = self.history.start.expand(len(points), -1)  # (B, 128)
            if history is not None:
                # Only rows with a history, which keeps the rest out of the batch statistics.
                rows = torch.nonzero(history.present).flatten()
                if len(rows):
                    encoded = self.history(history.points[rows], history.flow[rows])
                    z = z.index_put((rows,), encoded.to(z.dtype))
            for k, product in enumerate(self.products):
                tensors[f"factor{k}"] = product(z)
        return Context(**tensors)

    def points_of(self, context: Context) -> int:
        """Points per cloud of a context."""
        return context["points"].shape[1]

    def denoise(self, context: Context, noisy: Tensor, level: Tensor) -> Tensor:
        """(B, N, 3) noisy flow, (B,) step of the chain -> (B, N, 3) noise or flow."""
        if not self.config.diffusion:
            noisy = torch.zeros_like(noisy)  # regressors see the points alone
        tokens = self._point_features(_geometry_of(context), context, noisy)  # (B, N, D)
        if not self.config.diffusion:
            return self.read_out(tokens)  # type: ignore[no-any-return]
        condition = self.level(level)  # (B, D)
        for block in self.blocks:
            tokens = block(tokens, condition)
        # The other three channels are the published variances, which are not used.
        return self.output(tokens, condition)[..., :3]  # type: ignore[no-any-return]

    def _point_features(self, geometry: CloudGeometry, context: Context, noisy: Tensor) -> Tensor:
        """PointNet++ over the noisy flow: (B, N, 3) -> (B, N, D)."""
        first, second = geometry.levels
        a = self.sa1(noisy, first)  # (B, N/5, 128)
        b = self.sa2(a, second)  # (B, N/20, 256)
        g = _times(self.sa3(b, second.centres), context.get("factor0"))  # (B, 1024)
        x = _times(self.fp3(g, b, None), context.get("factor1"))  # (B, N/20, 256)
        x = _times(self.fp2(x, a, geometry.up2), context.get("factor2"))  # (B, N/5, 128)
        x = _times(self.fp1(x, noisy, geometry.up1), context.get("factor3"))  # (B, N, 128)
        for layer in self.head[:-1]:
            x = fn.leaky_relu(layer(x), 0.01)
        return self.head[-1](x)  # type: ignore[no-any-return]


def _times(x: Tensor, factor: Tensor | None) -> Tensor:
    """The Hadamard product with the history's projection, if the network has one."""
    if factor is None:
        return x
    return x * (factor if x.ndim == 2 else factor.unsqueeze(1))


def _geometry_of(context: Context) -> CloudGeometry:
    """The geometry back from the context's tensors."""
    first, second = (
        Level(*(context[f"{name}_{field}"] for field in ("centres", "index", "valid", "offset")))
        for name in ("first", "second")
    )
    return CloudGeometry(
        (first, second),
        (context["up2_weights"], context["up2_index"]),
        (context["up1_weights"], context["up1_index"]),
    )
