"""Histories of the network's own making: which are taken, and that a killed training goes on."""

from pathlib import Path

import numpy as np
import pytest
import torch

from flowbothd_model.config import PRESETS
from flowbothd_model.data.sampling import SampleConfig
from flowbothd_model.data.stream import Mixture, ProceduralSource
from flowbothd_model.metrics import field_cosine
from flowbothd_model.network.factory import build
from flowbothd_model.training.own_history import with_own_histories, would_move
from flowbothd_model.training.train_config import TrainConfig
from flowbothd_model.training.trainer import Trainer


def door() -> torch.Tensor:
    """(1, 6, 3) flow of a leaf whose last three points move along x, each more than the last."""
    flow = torch.zeros(1, 6, 3)
    flow[0, 3:, 0] = torch.tensor([0.3, 0.6, 1.0])
    return flow


def test_a_pull_along_the_truth_moves_the_part():
    assert would_move(door(), door()).tolist() == [True]


def test_a_pull_against_the_truth_moves_nothing():
    assert would_move(-door(), door()).tolist() == [False]


def test_what_is_said_of_still_parts_does_not_matter():
    said = door()
    said[0, 0] = torch.tensor([-5.0, 0.0, 0.0])
    assert would_move(said, door()).tolist() == [True]


def test_the_point_said_to_move_most_is_the_one_that_is_pulled():
    said = door()
    said[0, 3] = torch.tensor([-2.0, 0.0, 0.0])
    assert would_move(said, door()).tolist() == [False]


def test_nothing_moves_where_nothing_can():
    assert would_move(door(), torch.zeros(1, 6, 3)).tolist() == [False]


def cloud(seed: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(size=(4, 300, 3))).float()


def trained_a_little(preset: str) -> torch.nn.Module:
    """Random weights whose answer is not zero."""
    network = build(PRESETS[preset].network, torch.Generator().manual_seed(0))
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(
                0.05 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(1))
            )
    return network.eval()


@pytest.mark.parametrize("preset", ["compact", "compact-no-diffusion", "compact-diffusion"])
def test_a_share_of_the_histories_is_the_networks_own(preset):
    network, config = trained_a_little(preset), PRESETS[preset]
    truth = torch.nn.functional.normalize(cloud(1), dim=-1)

    def drawn(share: float, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
        generator = torch.Generator().manual_seed(seed)
        return with_own_histories(network, config, cloud(0), truth, share, generator)

    given, told = drawn(0.0)
    assert torch.equal(given, truth)
    assert told.all()
    given, told = drawn(1.0)
    assert torch.equal(given, drawn(1.0)[0])  # the same generator, the same histories
    assert not given.requires_grad
    own = (given != truth).flatten(1).any(1)
    assert own.any()
    assert torch.allclose(given[own].norm(dim=-1).amax(1), torch.ones(int(own.sum())), atol=1e-3)
    assert would_move(given, truth)[own].all()
    assert told[~own].all()
    assert not told[own].any()  # of random weights, about random truths


def test_a_hinge_on_the_wrong_side_does_not_tell_the_motion():
    side = torch.linspace(0, 1, 50)
    left, right = torch.zeros(1, 50, 3), torch.zeros(1, 50, 3)
    left[0, :, 0], right[0, :, 0] = side, 1 - side
    assert field_cosine(left, left).item() == pytest.approx(1)
    assert field_cosine(left, right).item() == pytest.approx(0.5, abs=0.05)


def run(folder: Path, steps: int, **changes: object) -> Trainer:
    settings = {"batch": 4, "draws": 1, "points": 256, "workers": 0, "device": "cpu"}
    config = TrainConfig(folder, steps=steps, situations="open_with_history", **settings, **changes)
    return Trainer(config, Mixture(((ProceduralSource(), 1.0),), SampleConfig(points=256)))


@pytest.mark.long
def test_own_histories_change_the_training_and_resume_alike(tmp_path):
    plain = run(tmp_path / "plain", 4)
    plain.run()
    whole = run(tmp_path / "whole", 4, own_histories=1.0)
    whole.run()
    assert any(
        not torch.equal(value, plain.averaged[name]) for name, value in whole.averaged.items()
    )
    first = run(tmp_path / "parts", 4, own_histories=1.0)
    keep = first._one_step

    def stop_at_two(batch):
        loss = keep(batch)
        first._stop = first.step == 2
        return loss

    first._one_step = stop_at_two
    first.run()
    second = run(tmp_path / "parts", 4, own_histories=1.0)
    assert second.step == 2
    second.run()
    for name, value in whole.averaged.items():
        assert torch.equal(value, second.averaged[name]), name


@pytest.mark.parametrize("share", [-0.1, 1.5])
def test_a_share_out_of_range_is_refused(share):
    with pytest.raises(ValueError, match="own_histories must be within 0 to 1"):
        TrainConfig(Path("x"), own_histories=share)
