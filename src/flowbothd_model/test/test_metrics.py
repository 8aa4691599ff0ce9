"""Errors of flows with known answers."""

import pytest
import torch

from flowbothd_model.metrics import flow_errors


def truth() -> torch.Tensor:
    flow = torch.zeros(10, 3)
    flow[:5, 0] = 0.5
    return flow


def test_the_truth_at_any_scale_has_no_error():
    errors = flow_errors(torch.stack((truth(), 7 * truth())), truth())
    assert torch.allclose(errors.cosine, torch.ones(2))
    assert errors.mean_error.max() < 1e-4
    assert errors.wrong_share == 0
    assert not errors.multimodal


def test_the_opposite_is_twice_as_far_as_the_flow_is_long():
    errors = flow_errors(-truth()[None], truth())
    assert float(errors.cosine[0]) == pytest.approx(-1.0)
    assert float(errors.mean_error[0]) == pytest.approx(2.0, rel=1e-3)
    assert float(errors.rmse[0]) == pytest.approx(2.0, rel=1e-3)
    assert float(errors.magnitude[0]) == pytest.approx(0.0, abs=1e-3)
    assert errors.wrong_share == 1


def test_the_winner_is_chosen_over_all_points_and_both_signs_are_multimodal():
    spill = truth()
    spill[5:, 1] = 0.5  # right where the part moves, wrong elsewhere
    errors = flow_errors(torch.stack((-truth(), spill, truth())), truth())
    assert errors.winner == 2
    assert errors.multimodal
    assert float(errors.squared[1]) > float(errors.squared[2])


def test_mean_error_and_rmse_differ_where_errors_are_uneven():
    half = truth()
    half[:2] = 0
    errors = flow_errors(half[None], truth())
    assert float(errors.mean_error[0]) == pytest.approx(0.4, rel=1e-3)
    assert float(errors.rmse[0]) == pytest.approx(0.4**0.5, rel=1e-3)


def test_a_truth_without_motion_is_refused():
    with pytest.raises(ValueError, match="no point moves"):
        flow_errors(truth()[None], torch.zeros(10, 3))


def test_the_whole_field_tells_left_from_right_where_points_cannot():
    """The incident: "modes found" counted a left hinge for a right one, at a cosine of 1."""
    across = torch.linspace(0.01, 0.99, 50)
    left, right = (torch.stack([w, 0 * w, 0 * w], dim=1) for w in (across, 1 - across))
    errors = flow_errors(left[None], right)
    assert float(errors.cosine[0]) > 0.99
    assert float(errors.field[0]) == pytest.approx(0.5, abs=0.05)
    assert float(flow_errors((left + right)[None], right).field[0]) == pytest.approx(0.87, abs=0.01)
    assert float(flow_errors(left[None], left).field[0]) == pytest.approx(1.0)
