"""Part of an object that the touching arm hides."""

import numpy as np
import pytest

from flowbothd_model.data.arm_shadow import hidden_by_arm
from flowbothd_model.data.sampling import SampleConfig, Situation, draw_sample
from flowbothd_model.data.stream import ProceduralSource


def wall(side=0.5, distance=1.0, count=4000):
    """A square before the camera, its left half another link than its right half."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-side / 2, side / 2, (2, count))
    return np.stack((x, y, np.full(count, distance)), axis=1), (x > 0).astype(np.int64)


def test_a_band_from_the_contact_is_hidden_and_nearly_never_the_whole_link():
    seen, link = wall()
    some = 0
    for seed in range(50):
        hidden = hidden_by_arm(seen, link, 1.0, np.random.default_rng(seed))
        assert hidden.shape == (len(seen),)
        if not hidden.any():
            continue
        some += 1
        touched = seen[int(np.random.default_rng(seed).integers(len(seen)))]
        assert hidden[np.linalg.norm(seen - touched, axis=1) < 0.01].all()
        assert min(hidden[link == k].mean() for k in (0, 1)) <= 0.6
    assert some > 25


def test_the_arm_keeps_its_size_in_other_units():
    seen, link = wall()
    first = hidden_by_arm(seen, link, 1.0, np.random.default_rng(3))
    assert np.array_equal(first, hidden_by_arm(4 * seen, link, 4.0, np.random.default_rng(3)))
    assert first.sum() > hidden_by_arm(seen, link, 0.3, np.random.default_rng(3)).sum() > 0


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_samples_lose_points_near_the_table_only_where_asked(share):
    config = SampleConfig(points=256, robot_share=1.0, arm_share=0.0, table_share=share)
    source = ProceduralSource({"Door": 1.0})
    lowest = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        sample = draw_sample(source.draw(rng), Situation.CLOSED, config, rng)
        if sample is not None:
            points = sample.current.points
            lowest.append(points[:, 2].min() / np.ptp(points[:, 2]))
    assert len(lowest) >= 8
    # An object stands on z = 0; noise reaches a little below it.
    assert (np.median(lowest) > 0.004) == bool(share)
