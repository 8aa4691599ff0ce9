"""The predictor: determinism, invariances, errors; and the files it is loaded from."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from flowbothd_common.errors import CheckpointError, InvalidCloudError
from flowbothd_common.types import History
from flowbothd_model import load
from flowbothd_model.checkpoint import read_checkpoint, save_checkpoint
from flowbothd_model.config import PRESETS, Architecture, ModelConfig, NetworkConfig
from flowbothd_model.network.factory import build
from flowbothd_model.predictor import Predictor, find_weights

CONFIG = replace(
    PRESETS["compact-diffusion"],
    network=NetworkConfig(Architecture.COMPACT, 64, 2, 1, 1, 32, 8, 16),
)


@pytest.fixture(scope="module")
def predictor() -> Predictor:
    generator = torch.Generator().manual_seed(0)
    network = build(CONFIG.network, generator)
    for parameter in network.parameters():
        if not parameter.any():
            parameter.data = torch.randn(parameter.shape, generator=generator) * 0.1
    return Predictor(network, CONFIG, "test")


@pytest.fixture
def cloud() -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.3, 0.3, (400, 3)).astype(np.float32)


def test_samples_are_normalised_and_follow_the_seed(predictor, cloud):
    flows = predictor.sample(cloud, samples=3, seed=5)
    assert flows.shape == (3, 400, 3)
    assert flows.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(flows, axis=2).max(1), 1.0, atol=1e-4)
    np.testing.assert_array_equal(flows, predictor.sample(cloud, samples=3, seed=5))
    assert not np.array_equal(flows, predictor.sample(cloud, samples=3, seed=6))
    assert not np.array_equal(predictor.sample(cloud), predictor.sample(cloud))
    assert not np.allclose(flows[0], flows[1])


@pytest.mark.parametrize("sampler", ["ddim", "ddpm"])
def test_order_place_and_scale_of_the_cloud_do_not_matter(predictor, cloud, sampler):
    order = np.random.default_rng(1).permutation(400)
    past = History(cloud * 0.9, np.ones((400, 3), np.float32))
    plain = predictor.sample(cloud, past, seed=2, sampler=sampler)
    mixed = predictor.sample(
        cloud[order], History(past.points[order], past.flow[order]), seed=2, sampler=sampler
    )
    np.testing.assert_allclose(plain[:, order], mixed, atol=1e-4)
    moved = predictor.sample(
        4 * cloud + 1.0, History(4 * past.points + 1.0, past.flow), seed=2, sampler=sampler
    )
    np.testing.assert_allclose(plain, moved, atol=2e-2)


def test_the_published_network_answers_the_same_for_any_order_too():
    config = replace(PRESETS["paper"], sampling_steps=2)
    network = Predictor(build(config.network), config, "paper")
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (256, 3)).astype(np.float32)
    order = np.random.default_rng(1).permutation(256)
    plain, mixed = network.sample(points, seed=1), network.sample(points[order], seed=1)
    np.testing.assert_allclose(plain[:, order], mixed, atol=1e-3)


def test_the_implicit_model_answers_in_one_step(cloud):
    config = PRESETS["compact"]
    network = Predictor(build(config.network), config, "one step")
    order = np.random.default_rng(1).permutation(400)
    flows = network.sample(cloud, samples=4, seed=3)
    np.testing.assert_allclose(
        flows[:, order], network.sample(cloud[order], samples=4, seed=3), atol=1e-4
    )
    with pytest.raises(ValueError, match="1 step, got 8"):
        network.sample(cloud, steps=8)
    with pytest.raises(ValueError, match="1 step, got 0"):
        network.sample(cloud, steps=0)


def test_history_changes_the_answer(predictor, cloud):
    past = History(cloud, np.ones((400, 3), np.float32))
    assert not np.allclose(
        predictor.sample(cloud, seed=1), predictor.sample(cloud, past, seed=1), atol=1e-3
    )


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda c: c[:100], "cloud has too few points; got 100; allowed: at least 256"),
        (lambda c: c[:, :2], r"cloud has the wrong shape; got \(400, 2\)"),
        (lambda c: np.where(np.arange(400)[:, None] == 3, np.nan, c), "not finite; got 1 of 400"),
        (lambda c: np.ones_like(c), "all points of the cloud coincide"),
    ],
)
def test_bad_clouds_say_what_is_wrong(predictor, cloud, spoil, words):
    with pytest.raises(InvalidCloudError, match=words):
        predictor.sample(spoil(cloud))


def test_bad_requests_say_what_is_allowed(predictor, cloud):
    with pytest.raises(ValueError, match="samples must be at least 1, got 0"):
        predictor.sample(cloud, samples=0)
    with pytest.raises(ValueError, match=r"steps must be in 1\.\.100, got 101"):
        predictor.sample(cloud, steps=101)
    with pytest.raises(ValueError, match="sampler must be one of"):
        predictor.sample(cloud, sampler="euler")
    short = History(cloud[:10], cloud[:10])
    with pytest.raises(InvalidCloudError, match="history has too few points"):
        predictor.sample(cloud, short)


def test_weights_come_back_from_their_file(tmp_path, predictor, cloud):
    network = predictor._network
    path = tmp_path / "door" / "model.safetensors"
    save_checkpoint(path, CONFIG, network.state_dict(), {"step": "12"})
    again = load(path.parent)
    assert again.model_id == "door@12"
    assert again.config == CONFIG
    np.testing.assert_array_equal(again.sample(cloud, seed=1), predictor.sample(cloud, seed=1))
    assert not path.with_suffix(".part").exists()


def test_weights_are_found_by_name(tmp_path, predictor, monkeypatch):
    path = tmp_path / "a" / "model.safetensors"
    save_checkpoint(path, CONFIG, predictor._network.state_dict())
    monkeypatch.setenv("FLOWBOTHD_MODELS", str(tmp_path))
    assert find_weights("a") == path
    with pytest.raises(CheckpointError, match="no weights called 'b'"):
        find_weights("b")


def test_chosen_folders_come_before_the_installation_and_the_repository(tmp_path, monkeypatch):
    monkeypatch.delenv("FLOWBOTHD_MODELS", raising=False)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    assert tmp_path not in find_weights("compact").parents
    share = tmp_path / "prefix" / "share" / "flowbothd_model" / "models"
    for folder in (share, tmp_path / "chosen"):
        (folder / "compact").mkdir(parents=True)
        (folder / "compact" / "model.safetensors").touch()
    assert find_weights("compact") == share / "compact" / "model.safetensors"
    monkeypatch.setenv("FLOWBOTHD_MODELS", str(tmp_path / "chosen"))
    assert find_weights("compact") == tmp_path / "chosen" / "compact" / "model.safetensors"


def test_files_that_are_not_ours_say_so(tmp_path, predictor):
    path = tmp_path / "model.safetensors"
    with pytest.raises(CheckpointError, match="no weights at"):
        read_checkpoint(path)
    path.write_bytes(b"\x00" * 100)
    with pytest.raises(CheckpointError, match="damaged"):
        load(path)
    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(CheckpointError, match="not written by FlowBotHD"):
        load(path)
    save_file({"a": torch.zeros(1)}, path, {"format": "flowbothd-1", "config": '{"name": "x"}'})
    with pytest.raises(CheckpointError, match="no usable configuration"):
        load(path)
    save_checkpoint(path, CONFIG, {"a": torch.zeros(1)})
    with pytest.raises(CheckpointError, match="do not fit"):
        load(path)
    save_checkpoint(path, CONFIG, predictor._network.state_dict())
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(CheckpointError, match="damaged"):
        load(path)


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_configurations_survive_the_file(preset):
    assert ModelConfig.from_dict(PRESETS[preset].to_dict()) == PRESETS[preset]


def test_configurations_out_of_range_are_refused():
    with pytest.raises(ValueError, match="width must be a multiple of heads"):
        NetworkConfig(width=100, heads=3)
    with pytest.raises(ValueError, match="tokens"):
        NetworkConfig(Architecture.COMPACT)
    with pytest.raises(ValueError, match="sampler must be"):
        ModelConfig(sampler="magic")
    with pytest.raises(ValueError, match="go together"):
        replace(PRESETS["compact"], diffusion=PRESETS["compact-diffusion"].diffusion)
    with pytest.raises(ValueError, match="unknown entries"):
        ModelConfig.from_dict({**PRESETS["paper"].to_dict(), "colour": 1})
