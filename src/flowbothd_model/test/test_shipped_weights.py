"""The weights in models/ are whole, described, and do what their cards say in the main."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch

from flowbothd_common.types import History
from flowbothd_model import load
from flowbothd_model.benchmark import example_cloud
from flowbothd_model.config import Schedule
from flowbothd_model.evaluate import mode_flows
from flowbothd_model.metrics import flow_errors

MODELS = sorted((Path(__file__).resolve().parents[3] / "models").glob("*/model.safetensors"))
each_model = pytest.mark.parametrize("path", MODELS, ids=lambda path: path.parent.name)
FULL = [p for p in MODELS if p.parent.name in ("compact", "compact-doors", "compact-procedural")]
each_full_model = pytest.mark.parametrize("path", FULL, ids=lambda path: path.parent.name)


@each_model
def test_a_card_names_these_very_bytes(path):
    assert path.stat().st_size < 20_000_000
    card = (path.parent / "card.md").read_text(encoding="utf-8")
    assert hashlib.sha256(path.read_bytes()).hexdigest() in card
    assert "Licence" in card
    objective = load(path).config.diffusion.schedule
    words = "implicit maximum likelihood" if objective is Schedule.IMPLICIT else "regression"
    assert "One-step model" in card and words in card.split("- **Licence**")[0]


@each_full_model
def test_a_history_is_followed(path):
    """A half-open door with a history: samples agree with the motion that was seen."""
    points, history = example_cloud()
    flows = load(path).sample(points, history, samples=5, seed=0)
    seen = history.flow[np.linalg.norm(history.flow, axis=1) > 0.5].mean(0)
    predicted = np.stack([f[np.linalg.norm(f, axis=1) > 0.5].mean(0) for f in flows])
    assert (predicted @ seen > 0).all()
    opposite = load(path).sample(points, History(history.points, -history.flow), samples=5, seed=0)
    assert not np.allclose(flows, opposite, atol=0.1)


@each_full_model
def test_every_mode_of_a_closed_door_is_some_samples_answer(path):
    view = mode_flows(1, 1200)
    assert view is not None
    seen, modes = view
    flows = torch.from_numpy(load(path).sample(seen.points, samples=50, seed=0))
    agreement = torch.stack([flow_errors(flows, torch.from_numpy(m)).field for m in modes])
    assert len(agreement.argmax(0).unique()) == len(modes), "a mode is nobody's answer"
    clear = 0.8 if path.parent.name == "compact-doors" else 0.55
    assert int((agreement.amax(1) > clear).sum()) >= 3, agreement.amax(1)


def test_ablations_lack_what_their_names_say():
    points, history = example_cloud()
    for path in MODELS:
        predictor, name = load(path), path.parent.name
        told = predictor.sample(points, history, samples=2, seed=0)
        untold = predictor.sample(points, None, samples=2, seed=0)
        forgets = name.endswith("no-history") or "flowbot3d" in name
        assert np.array_equal(told, untold) == forgets, name
        one_answer = name.endswith("no-diffusion") or "flowbot3d" in name
        assert np.array_equal(told[0], told[1]) == one_answer, name
