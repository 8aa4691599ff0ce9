"""The noise process against what is known of it in closed form."""

import math

import pytest
import torch

from flowbothd_model.config import PRESETS, DiffusionConfig, Schedule, Target
from flowbothd_model.network.diffusion import Diffusion

LINEAR = DiffusionConfig()
STRAIGHT = DiffusionConfig(Schedule.STRAIGHT, Target.FLOW, shift=3.0)


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_the_published_chain_ends_in_noise():
    mix = Diffusion(LINEAR).mix(torch.tensor([0.0, 0.01, 1.0]), 1200)
    assert mix.signal[0] == 1
    assert mix.noise[0] == 0
    assert float(mix.signal[1] ** 2) == pytest.approx(1 - 0.001, rel=1e-6)
    assert float(mix.signal[2] ** 2) == pytest.approx(2.0e-5, rel=0.05)


@pytest.mark.parametrize("config", [LINEAR, STRAIGHT, PRESETS["compact-diffusion"].diffusion])
def test_levels_only_ever_add_noise(config):
    mix = Diffusion(config).mix(torch.linspace(0, 1, 101), 600)
    assert (mix.signal.diff() < 0).all()
    assert (mix.noise.diff() > 0).all()


@pytest.mark.parametrize("config", [LINEAR, STRAIGHT])
@pytest.mark.parametrize("eta", [0.0, 1.0])
@pytest.mark.parametrize("steps", [1, 3, 20, 100])
def test_whoever_knows_the_flow_gets_it_back(config, eta, steps):
    process = Diffusion(config)
    truth = torch.randn(2, 50, 3, generator=generator())

    def oracle(noisy: torch.Tensor, level: torch.Tensor) -> torch.Tensor:
        if config.target is Target.FLOW:
            return truth
        mix = process.mix(level, 50)
        return (noisy - mix.signal[:, None, None] * truth) / mix.noise[:, None, None]

    noise = torch.randn(2, 50, 3, generator=generator())
    result = process.sample(oracle, noise, steps, eta, generator())
    assert torch.allclose(result, truth, atol=2e-2)


@pytest.mark.parametrize("config", [LINEAR, STRAIGHT])
@pytest.mark.parametrize("eta", [0.0, 1.0])
def test_the_exact_denoiser_of_a_gaussian_gives_its_variance(config, eta):
    """For flows ~ N(0, 0.3^2) the best prediction is linear, and samples must have that spread."""
    process, deviation = Diffusion(config), 0.3

    def best(noisy: torch.Tensor, level: torch.Tensor) -> torch.Tensor:
        mix = process.mix(level.double(), 500)
        a, s = (v[:, None, None].float() for v in (mix.signal, mix.noise))
        flow = noisy * a * deviation**2 / (a**2 * deviation**2 + s**2)
        return flow if config.target is Target.FLOW else (noisy - a * flow) / s

    noise = torch.randn(8, 500, 3, generator=generator())
    samples = process.sample(best, noise, 100, eta, generator())
    # The ancestral sampler's variance is that of a known flow, hence a little too small.
    assert float(samples.std()) == pytest.approx(deviation, rel=0.1 if eta else 0.06)


@pytest.mark.parametrize("config", [LINEAR, STRAIGHT])
@pytest.mark.parametrize("eta", [0.0, 1.0])
def test_the_exact_denoiser_of_two_modes_finds_both_and_nothing_between(config, eta):
    process = Diffusion(config)
    mode = torch.zeros(40, 3)
    mode[:, 0] = 0.5

    def best(noisy: torch.Tensor, level: torch.Tensor) -> torch.Tensor:
        mix = process.mix(level.double(), 40)
        a, s = (v[:, None, None].float() for v in (mix.signal, mix.noise))
        lean = torch.tanh((noisy * mode).sum((1, 2), keepdim=True) * a / s**2)
        return lean * mode if config.target is Target.FLOW else (noisy - a * lean * mode) / s

    noise = torch.randn(200, 40, 3, generator=generator())
    samples = process.sample(best, noise, 100, eta, generator())
    lean = samples[:, :, 0].mean(1) / 0.5
    assert 60 < int((lean > 0).sum()) < 140
    assert float((lean.abs() > 0.9).float().mean()) > 0.95


def test_noise_on_a_patch_does_not_depend_on_the_density():
    process = Diffusion(PRESETS["compact-diffusion"].diffusion)
    level = torch.tensor([0.5])
    for points in (256, 1024, 4096):
        share = points // 128
        mean_noise = float(process.mix(level, points).noise) / math.sqrt(share)
        assert mean_noise == pytest.approx(float(process.mix(level, 1024).noise) / math.sqrt(8))


@pytest.mark.parametrize("steps", [0, 101])
def test_steps_out_of_range_are_refused(steps):
    noise = torch.zeros(1, 5, 3)
    with pytest.raises(ValueError, match=r"steps must be in 1\.\.100"):
        Diffusion(LINEAR).sample(lambda x, _: x, noise, steps, 0.0, generator())


def test_the_loss_is_zero_for_the_truth_and_counts_direction():
    process = Diffusion(DiffusionConfig(Schedule.STRAIGHT, Target.FLOW, angle_weight=0.5))
    flow = torch.randn(2, 30, 3, generator=generator())
    noise, level = torch.zeros_like(flow), torch.tensor([0.2, 0.4])
    assert float(process.loss(flow, flow, noise, level)) == pytest.approx(0.0, abs=1e-5)
    opposite = float(process.loss(-flow, flow, noise, level))
    assert 4.0 < opposite < 6.0  # twice the flow, squared, relative to it; and the angle
    small = 0.01 * flow  # of clouds with hardly any flow the weight stays bounded
    assert float(process.loss(-small, small, noise, level)) < opposite
    assert float(Diffusion(LINEAR).loss(noise + 1, flow, noise, level)) == pytest.approx(1.0)


def test_random_levels_are_the_chain_or_spread_over_the_batch():
    chain = Diffusion(LINEAR).random_levels(500, generator()) * 100
    assert torch.allclose(chain, chain.round())
    assert chain.min() >= 1
    even = Diffusion(STRAIGHT).random_levels(10, generator()).sort()[0]
    assert torch.allclose(even.diff(), torch.full((9,), 0.1), atol=1e-4)
