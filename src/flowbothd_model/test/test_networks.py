"""Both networks: published sizes, shapes, what they depend on and what they do not."""

import json
from pathlib import Path

import pytest
import torch

from flowbothd_model.config import PRESETS, Architecture, NetworkConfig
from flowbothd_model.network.factory import build
from flowbothd_model.network.network import FlowNetwork, HistoryBatch
from flowbothd_model.network.pointnet2 import PointMlp

GOLDEN = Path(__file__).parent / "golden" / "networks.json"
SMALL = NetworkConfig(Architecture.COMPACT, 64, 2, 1, 1, 32, 8, 16)


def count(module: torch.nn.Module) -> int:
    return sum(p.numel() for p in module.parameters())


def clouds(batch: int = 2, points: int = 300) -> tuple[torch.Tensor, HistoryBatch, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    draw = [torch.randn(batch, points, 3, generator=generator) for _ in range(4)]
    present = torch.arange(batch) % 2 == 0
    return draw[0] * 0.5, HistoryBatch(draw[1] * 0.5, draw[2], present), draw[3]


def awake(network: FlowNetwork) -> FlowNetwork:
    """Evaluation mode with every zero-initialised weight made non-zero, as after training."""
    generator = torch.Generator().manual_seed(1)
    for parameter in network.parameters():
        if not parameter.any():
            parameter.data = torch.randn(parameter.shape, generator=generator) * 0.05
    return network.eval()


def test_the_published_network_has_the_published_number_of_parameters():
    network = build(PRESETS["paper"].network)
    sizes = {name: count(part) for name, part in network.named_children()}
    assert count(network) == 3_542_406
    assert [sizes[k] for k in ("sa1", "sa2", "sa3")] == [13_184, 66_944, 724_992]
    assert [sizes[k] for k in ("fp3", "fp2", "fp1")] == [394_240, 131_968, 50_432]
    assert sizes["head"] == 3 * 16_512
    assert [count(p) for p in network.products] == [132_096, 33_024, 16_512, 16_512]
    assert [count(p) for p in network.blocks] == [296_832] * 5
    assert count(network.blocks[0].attention) == 66_048
    assert count(network.blocks[0].mlp) == 131_712
    assert count(network.blocks[0].modulation) == 99_072
    assert sizes["level"] == 49_408
    assert sizes["output"] == 33_798
    assert sizes["history"] == 345_600
    history = {name: count(part) for name, part in network.history.named_children()}
    assert history == {"sa1": 13_184, "sa2": 66_944, "sa3": 265_344}


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_every_preset_predicts_a_flow_for_every_point(preset):
    network = awake(build(PRESETS[preset].network))
    points, history, noisy = clouds()
    if PRESETS[preset].network.latent:
        noisy = noisy[:, 0, :1].expand(-1, PRESETS[preset].network.latent)
    with torch.inference_mode():
        first = network(points, history, noisy, torch.tensor([5.0, 50.0]))
        again = network(points, history, noisy, torch.tensor([5.0, 50.0]))
        other_noise = network(points, history, noisy + 1, torch.tensor([5.0, 50.0]))
        without = network(points, None, noisy, torch.tensor([5.0, 50.0]))
    assert first.shape == (2, 300, 3)
    assert torch.equal(first, again)
    assert torch.equal(first, other_noise) == (not PRESETS[preset].network.diffusion)
    assert torch.equal(first[0], without[0]) == (not PRESETS[preset].network.history)
    assert torch.allclose(first[1], without[1], atol=1e-4)  # row 1 has no history


@pytest.mark.parametrize("preset", ["paper", "compact-diffusion"])
def test_samples_of_one_encoding_equal_encoding_every_time(preset):
    network = awake(build(PRESETS[preset].network))
    points, history, noisy = clouds(1)
    three = torch.cat((noisy, noisy * 0.5, noisy - 1))
    level = torch.tensor([10.0, 20.0, 30.0])
    with torch.inference_mode():
        shared = network.denoise(network.encode(points, history).repeated(3), three, level)
        single = [network(points, history, three[k : k + 1], level[k : k + 1]) for k in range(3)]
    assert torch.allclose(shared, torch.cat(single), atol=1e-4)


@pytest.mark.parametrize("rectify", [False, True])
def test_norms_folded_into_the_next_layer_change_nothing(rectify):
    mlp = PointMlp((4, 8, 16, 5), rectify)
    generator = torch.Generator().manual_seed(0)
    for _ in range(5):
        mlp(torch.randn(200, 4, generator=generator) * 3 + 1)  # moves the running statistics
    for norm in mlp.norms:
        norm.weight.data = torch.rand(norm.weight.shape, generator=generator) + 0.5
        norm.bias.data = torch.randn(norm.bias.shape, generator=generator)
    mlp.eval()
    x = torch.randn(3, 7, 4, generator=generator)
    with torch.no_grad():
        folded = mlp(x)
    assert torch.allclose(mlp(x), folded, atol=1e-5)


@pytest.mark.parametrize("points", [256, 777, 2500])
def test_the_compact_network_takes_any_number_of_points(points):
    network = awake(build(SMALL))
    cloud, history, noisy = clouds(1, points)
    with torch.inference_mode():
        assert network(cloud, history, noisy, torch.tensor([1.0])).shape == (1, points, 3)


def test_the_compact_network_does_not_depend_on_the_order_of_points():
    network = awake(build(SMALL))
    points, history, noisy = clouds(1)
    order = torch.randperm(300, generator=torch.Generator().manual_seed(3))
    level = torch.tensor([40.0])
    shuffled = HistoryBatch(history.points[:, order], history.flow[:, order], history.present)
    with torch.inference_mode():
        plain = network(points, history, noisy, level)
        mixed = network(points[:, order], shuffled, noisy[:, order], level)
    assert torch.allclose(plain[:, order], mixed, atol=1e-4)


@pytest.mark.parametrize("preset", ["paper", "compact", "compact-diffusion"])
def test_every_weight_learns(preset):
    """Every parameter gets a gradient, apart from the published variances' row."""
    network = awake(build(PRESETS[preset].network)).train()
    points, history, noisy = clouds(4)
    noisy = noisy[:, :4, :2].flatten(1) if preset == "compact" else noisy  # its (4, 8) vectors
    network(points, history, noisy, torch.full((4,), 30.0)).square().mean().backward()
    lazy = [n for n, p in network.named_parameters() if p.grad is None or not p.grad.any()]
    assert lazy == []
    if preset == "paper":
        assert not network.output.project.weight.grad[3:].any()


def statistics(preset: str) -> dict[str, float]:
    """Forward and gradient norms of a seeded network on fixed input."""
    network = awake(build(PRESETS[preset].network, torch.Generator().manual_seed(7)))
    points, history, noisy = clouds(2)
    noisy = noisy[:, :4, :2].flatten(1) if preset == "compact" else noisy
    output = network(points, history, noisy, torch.tensor([20.0, 80.0]))
    output.square().mean().backward()
    gradient = sum(float(p.grad.square().sum()) for p in network.parameters() if p.grad is not None)
    return {
        "mean": float(output.detach().abs().mean()),
        "spread": float(output.detach().std()),
        "gradient": gradient**0.5,
    }


@pytest.mark.golden
@pytest.mark.parametrize("preset", ["paper", "compact", "compact-diffusion"])
def test_forward_and_gradient_statistics_are_those_on_record(preset):
    """To renew the record after a wanted change, run this file as a script."""
    expected = json.loads(GOLDEN.read_text(encoding="utf-8"))[preset]
    assert statistics(preset) == pytest.approx(expected, rel=2e-3)


if __name__ == "__main__":
    GOLDEN.parent.mkdir(exist_ok=True)
    record = {preset: statistics(preset) for preset in ("paper", "compact", "compact-diffusion")}
    GOLDEN.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
