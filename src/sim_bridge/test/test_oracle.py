"""Oracles: the truth, its ambiguity, its noise."""

from collections import Counter

import numpy as np
import pytest

from flowbothd_common.errors import InvalidCloudError, ParameterError
from sim_bridge.oracle import GroundTruthFlow, OracleParams, OraclePredictor, draw

EXACT = OracleParams(noise=0.0, tilt=0.0)
POINTS = np.random.default_rng(7).uniform(-0.2, 0.2, (60, 3)).astype(np.float32)
MODES = ("pull_left", "pull_right", "push_left", "push_right")


def door(points, open_ratio=0.0):
    """The flows of a leaf about its left and right edge, towards and away from the camera."""
    flows = []
    for mode in MODES:
        lever = points[:, 1] + (0.2 if mode.endswith("left") else -0.2)
        flow = np.zeros_like(points)
        flow[:, 0] = np.abs(lever) * (-1 if mode.startswith("pull") else 1)
        flows.append(flow / np.abs(flow).max())
    return GroundTruthFlow(np.asarray(flows, np.float32), MODES, open_ratio)


def which_mode(flow):
    distances = [np.linalg.norm(flow - candidate) for candidate in door(POINTS).flows]
    return MODES[int(np.argmin(distances))]


@pytest.mark.parametrize("name", ["oracle", "ambiguous"])
def test_shape_norm_and_seed(name):
    predictor = OraclePredictor(door, OracleParams(name))
    assert predictor.model_id == name
    flows = predictor.sample(POINTS, samples=3, seed=5)
    assert flows.shape == (3, len(POINTS), 3)
    assert flows.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(flows, axis=2).max(axis=1), 1, rtol=1e-5)
    np.testing.assert_array_equal(flows, predictor.sample(POINTS, samples=3, seed=5))
    assert not np.array_equal(flows, predictor.sample(POINTS, samples=3, seed=6))


def test_without_noise_it_is_the_truth():
    np.testing.assert_allclose(draw(door(POINTS), EXACT, 1, 0)[0], door(POINTS).flows[0], atol=1e-6)


def test_closed_it_draws_every_mode_alike():
    flows = draw(door(POINTS), OracleParams("ambiguous", 0.0, 0.0), 400, 1)
    counts = Counter(which_mode(flow) for flow in flows)
    assert set(counts) == set(MODES)
    assert min(counts.values()) > 70


def test_open_it_is_wrong_one_time_in_five():
    flows = draw(door(POINTS, 0.3), OracleParams("ambiguous", 0.0, 0.0), 500, 2)
    right = sum(which_mode(flow) == "pull_left" for flow in flows)
    assert 0.74 < right / 500 < 0.86


def test_a_single_candidate_errs_by_closing():
    flow = np.zeros((1, 20, 3), np.float32)
    flow[..., 0] = 1
    wrong = OracleParams("ambiguous", 0.0, 0.0, wrong_mode_probability=1.0)
    half_open, closed = (GroundTruthFlow(flow, ("only",), ratio) for ratio in (0.5, 0.0))
    np.testing.assert_array_equal(draw(half_open, wrong, 1, 0)[0], -flow[0])
    np.testing.assert_array_equal(draw(closed, wrong, 1, 0)[0], flow[0])


def test_a_part_that_cannot_be_seen_has_no_flow():
    truth = GroundTruthFlow(np.zeros((1, 5, 3), np.float32), ("x",), 0.0)
    assert not draw(truth, OracleParams(), 1, 0).any()


def test_errors_say_what_is_allowed():
    with pytest.raises(ParameterError, match=r"got psychic; allowed: oracle, ambiguous"):
        OracleParams("psychic")
    with pytest.raises(ParameterError, match=r"probability of a wrong mode.*1\.5.*0\.\.1"):
        OracleParams(wrong_mode_probability=1.5)
    with pytest.raises(InvalidCloudError, match="wrong shape"):
        GroundTruthFlow(np.zeros((5, 3), np.float32), ("a",), 0.0)
    with pytest.raises(InvalidCloudError, match="differ in number"):
        GroundTruthFlow(np.zeros((2, 5, 3), np.float32), ("a",), 0.0)
    with pytest.raises(ParameterError, match="number of samples"):
        draw(door(POINTS), OracleParams(), 0, 0)
