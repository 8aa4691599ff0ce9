"""The weights in models/ are whole, described, and do what their cards say in the main."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch

from flowbothd_common.types import History
from flowbothd_model import load
from flowbothd_model.benchmark import example_cloud
from flowbothd_model.evaluate import mode_flows
from flowbothd_model.metrics import flow_errors

MODELS = sorted((Path(__file__).resolve().parents[3] / "models").glob("*/model.safetensors"))
each_model = pytest.mark.parametrize("path", MODELS, ids=lambda path: path.parent.name)


@each_model
def test_a_card_names_these_very_bytes(path):
    assert path.stat().st_size < 20_000_000
    card = (path.parent / "card.md").read_text(encoding="utf-8")
    assert hashlib.sha256(path.read_bytes()).hexdigest() in card
    assert "Licence" in card


@each_model
def test_a_history_is_followed(path):
    """A half-open door with a history: samples agree with the motion that was seen."""
    points, history = example_cloud()
    flows = load(path).sample(points, history, samples=5, seed=0)
    seen = history.flow[np.linalg.norm(history.flow, axis=1) > 0.5].mean(0)
    predicted = np.stack([f[np.linalg.norm(f, axis=1) > 0.5].mean(0) for f in flows])
    assert (predicted @ seen > 0).all()
    opposite = load(path).sample(points, History(history.points, -history.flow), samples=5, seed=0)
    assert not np.allclose(flows, opposite, atol=0.1)


@each_model
def test_most_modes_of_a_closed_door_are_found(path):
    view = mode_flows(1, 1200)
    assert view is not None
    seen, modes = view
    flows = torch.from_numpy(load(path).sample(seen.points, samples=50, seed=0))
    best = [float(flow_errors(flows, torch.from_numpy(mode)).cosine.max()) for mode in modes]
    assert sum(cosine > 0.9 for cosine in best) >= 3, best
