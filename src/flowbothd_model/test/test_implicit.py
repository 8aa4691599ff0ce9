"""One-step training: the nearest hypothesis learns."""

import torch

from flowbothd_model.network.implicit import implicit_prediction, relative_error, spread_vectors
from flowbothd_model.network.network import Context, FlowNetwork, HistoryBatch


class Signs(FlowNetwork):
    """Answers with the sign of the vector's first entry, along x."""

    def encode(self, points: torch.Tensor, history: HistoryBatch | None) -> Context:
        return Context(points=points)

    def denoise(self, context: Context, noisy: torch.Tensor, level: torch.Tensor) -> torch.Tensor:
        flow = context["points"].new_zeros((len(noisy), *context["points"].shape[1:]))
        flow[..., 0] = noisy[:, :1].sign()
        return flow


def answers(told: bool, hypotheses: int) -> torch.Tensor:
    """Which way the learning hypothesis of 500 clouds goes; the truth is +x."""
    points = torch.zeros(500, 4, 3)
    truth = torch.zeros(500, 4, 3)
    truth[..., 0] = 1.0
    history = HistoryBatch(points, truth, torch.full((500,), True))
    telling = torch.full((500,), told)
    generator = torch.Generator().manual_seed(0)
    chosen = implicit_prediction(
        Signs(), points, history, telling, truth, 2, hypotheses, 0.1, generator
    )
    return chosen[:, 0, 0]


def test_the_nearest_hypothesis_learns_but_now_and_then_any():
    wrong = float((answers(False, 6) < 0).float().mean())
    # One in twenty is left to chance, and half of those go wrong.
    assert 0.005 < wrong < 0.06


def test_vectors_of_one_cloud_lie_in_different_octants_and_are_normal():
    vectors = spread_vectors(3000, 8, 5, torch.Generator().manual_seed(0))
    octant = ((vectors[..., :3] < 0).long() * torch.tensor([1, 2, 4])).sum(-1)
    assert (octant.sort(-1)[0] == torch.arange(8)).all()
    first = vectors[:, 0]  # one vector alone is an ordinary draw
    assert first.mean(0).abs().max() < 0.06
    assert (first.std(0) - 1).abs().max() < 0.05
    assert spread_vectors(2, 11, 2, torch.Generator().manual_seed(0)).shape == (2, 11, 2)


def test_with_a_history_that_tells_the_motion_mostly_any_learns():
    wrong = float((answers(True, 6) < 0).float().mean())
    assert 0.28 < wrong < 0.42


def test_one_hypothesis_is_plain_regression():
    assert 0.42 < float((answers(False, 1) < 0).float().mean()) < 0.58


def test_the_error_is_relative_and_bounded_for_small_flows():
    flow = torch.zeros(2, 10, 3)
    flow[0, :, 0], flow[1, :, 0] = 1.0, 0.001
    error = relative_error(torch.zeros_like(flow), flow, 0.0)
    assert 0.9 < float(error[0]) < 1.0
    assert float(error[1]) < 1e-3
    assert torch.allclose(relative_error(flow, flow, 1.0), torch.zeros(2), atol=1e-3)
