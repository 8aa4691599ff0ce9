"""Oracles: the truth, its ambiguity, its noise."""

from collections import Counter

import numpy as np
import pytest

from flowbothd_common.errors import InvalidCloudError, ParameterError
from flowbothd_policy.oracle import OracleParams, OraclePredictor, Truth, draw
from flowbothd_policy.predictor import FlowPredictor, max_normalised

CLEAN = OracleParams(noise=0.0, tilt=0.0)


def which_mode(door, points, flow):
    truth = door.truth(points)
    return truth.modes[int(np.argmin([np.linalg.norm(flow - f) for f in truth.flows]))]


def test_it_is_a_flow_predictor(make_door):
    assert isinstance(OraclePredictor(make_door("pull_left").truth), FlowPredictor)


@pytest.mark.parametrize("mode", ["oracle", "ambiguous"])
def test_shape_norm_and_seed(make_door, mode):
    door = make_door("pull_left")
    points = door.observe()
    predictor = OraclePredictor(door.truth, OracleParams(mode))
    flows = predictor.sample(points, samples=3, seed=5)
    assert flows.shape == (3, len(points), 3)
    assert flows.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(flows, axis=2).max(axis=1), 1, rtol=1e-5)
    np.testing.assert_array_equal(flows, predictor.sample(points, samples=3, seed=5))
    assert not np.array_equal(flows, predictor.sample(points, samples=3, seed=6))


def test_without_noise_it_is_the_truth(make_door):
    door = make_door("push_left")
    points = door.observe()
    np.testing.assert_allclose(
        draw(door.truth(points), CLEAN, 1, 0)[0], door.truth(points).flows[0], atol=1e-6
    )


def test_closed_it_draws_every_mode_alike(make_door):
    door = make_door("pull_left")
    points = door.observe()
    flows = draw(door.truth(points), OracleParams("ambiguous", 0.0, 0.0), 400, 1)
    counts = Counter(which_mode(door, points, flow) for flow in flows)
    assert set(counts) == {"pull_left", "pull_right", "push_left", "push_right"}
    assert min(counts.values()) > 70


def test_open_it_is_wrong_one_time_in_five(make_door):
    door = make_door("pull_left", angle=0.3)
    points = door.observe()
    flows = draw(door.truth(points), OracleParams("ambiguous", 0.0, 0.0), 500, 2)
    right = sum(which_mode(door, points, flow) == "pull_left" for flow in flows)
    assert 0.74 < right / 500 < 0.86


def test_a_single_candidate_errs_by_closing():
    flow = np.zeros((1, 20, 3), np.float32)
    flow[..., 0] = 1
    wrong = OracleParams("ambiguous", 0.0, 0.0, wrong_mode_probability=1.0)
    np.testing.assert_array_equal(draw(Truth(flow, ("only",), 0.5), wrong, 1, 0)[0], -flow[0])
    np.testing.assert_array_equal(draw(Truth(flow, ("only",), 0.0), wrong, 1, 0)[0], flow[0])


def test_a_part_that_cannot_be_seen_has_no_flow():
    truth = Truth(np.zeros((1, 5, 3), np.float32), ("x",), 0.0)
    assert not draw(truth, OracleParams(), 1, 0).any()
    assert not max_normalised(np.zeros((2, 4, 3))).any()


def test_errors_say_what_is_allowed():
    with pytest.raises(ParameterError, match=r"got psychic; allowed: oracle, ambiguous"):
        OracleParams("psychic")
    with pytest.raises(ParameterError, match=r"probability of a wrong mode.*1\.5.*0\.\.1"):
        OracleParams(wrong_mode_probability=1.5)
    with pytest.raises(InvalidCloudError, match="wrong shape"):
        Truth(np.zeros((5, 3), np.float32), ("a",), 0.0)
    with pytest.raises(InvalidCloudError, match="differ in number"):
        Truth(np.zeros((2, 5, 3), np.float32), ("a",), 0.0)
    with pytest.raises(ParameterError, match="number of samples"):
        draw(Truth(np.zeros((1, 5, 3), np.float32), ("a",), 0.0), OracleParams(), 0, 0)
