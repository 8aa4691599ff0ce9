"""Batches are the same whoever makes them, and wherever one begins."""

from itertools import islice

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from flowbothd_model.data.articulated import flow_of
from flowbothd_model.data.procedural.catalogue import HELD_OUT_FROM, make
from flowbothd_model.data.sampling import SampleConfig, Situation, draw_sample
from flowbothd_model.data.stream import (
    BatchStream,
    Mixture,
    ProceduralSource,
    collate,
    stretched,
)


def mixture(seed: int = 0) -> Mixture:
    return Mixture(((ProceduralSource(), 1.0),), SampleConfig(points=256), seed=seed)


def test_workers_change_nothing_and_a_run_resumes_in_the_middle():
    alone = list(islice(iter(BatchStream(mixture(), 3)), 4))
    loader = DataLoader(BatchStream(mixture(), 3), batch_size=None, num_workers=2)
    shared = list(islice(iter(loader), 4))
    later = next(iter(BatchStream(mixture(), 3, first=2)))
    for a, b in zip(alone, shared, strict=True):
        assert torch.equal(a.points, b.points)
        assert torch.equal(a.history_flow, b.history_flow)
    assert torch.equal(alone[2].points, later.points)
    assert not torch.equal(alone[0].points, alone[1].points)


def test_processes_share_the_batches():
    whole = [b.points for b in islice(iter(BatchStream(mixture(), 2)), 4)]
    odd = [b.points for b in islice(iter(BatchStream(mixture(), 2, first=1, stride=2)), 2)]
    assert torch.equal(odd[0], whole[1])
    assert torch.equal(odd[1], whole[3])


def test_another_seed_gives_other_samples():
    assert not np.array_equal(
        mixture(0).sample_at(0, 0).current.points, mixture(1).sample_at(0, 0).current.points
    )


def test_held_out_numbers_are_never_drawn_for_training():
    names = {ProceduralSource().draw(np.random.default_rng(k)).name for k in range(50)}
    held = {ProceduralSource(held_out=True).draw(np.random.default_rng(k)).name for k in range(50)}
    assert all(int(name.split("-")[1]) < HELD_OUT_FROM for name in names)
    assert all(int(name.split("-")[1]) >= HELD_OUT_FROM for name in held)


def test_situations_come_in_thirds_and_missing_histories_are_zero():
    samples = [mixture().sample_at(0, k) for k in range(90)]
    counts = [sum(s.situation is kind for s in samples) for kind in Situation]
    assert min(counts) > 15
    batch = collate(samples[:20])
    assert batch.points.shape == batch.history_points.shape == (20, 256, 3)
    assert not batch.history_points[~batch.has_history].any()
    assert batch.history_flow[batch.has_history].any()


def test_history_is_a_little_less_open_than_the_present():
    door = make("Safe", 1)
    shown = SampleConfig(points=256, augment=False, single_share=1.0)
    for k in range(5):
        sample = draw_sample(door, Situation.HISTORY, shown, np.random.default_rng(k))
        assert sample is not None
        assert sample.history is not None
        assert not np.array_equal(sample.current.points, sample.history.points)


@pytest.mark.parametrize("category", ["Door", "StorageFurniture", "Window"])
def test_a_stretched_object_still_turns_about_its_hinges(category):
    for number in range(8):
        item = stretched(make(category, number), np.array([1.2, 0.8]))
        here = item.closed() + 0.2 * np.array([j.movable for j in item.joints])
        step = np.array([1e-3 if j.movable else 0.0 for j in item.joints])
        before, after = item.posed_vertices(here), item.posed_vertices(here + step)
        flow = flow_of(item.opening_twists(here), item.vertex_link, before)
        np.testing.assert_allclose((after - before) / 1e-3, flow, atol=5e-3)


@pytest.mark.parametrize(
    ("change", "words"), [({"points": 10}, "256"), ({"min_step": 0.8}, "min_step")]
)
def test_settings_out_of_range_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        SampleConfig(**change)
