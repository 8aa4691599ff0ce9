"""Training: the same curve from the same seed, and nothing lost by a kill."""

import multiprocessing
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from flowbothd_model.checkpoint import read_checkpoint
from flowbothd_model.data.sampling import SampleConfig, Situation
from flowbothd_model.data.stream import Mixture, ProceduralSource
from flowbothd_model.metrics import flow_errors
from flowbothd_model.training.run_log import read_rows
from flowbothd_model.training.train import main
from flowbothd_model.training.train_config import TrainConfig
from flowbothd_model.training.trainer import Trainer
from flowbothd_model.training.validation import ValidationSet


def trainer(folder: Path, steps: int, preset: str = "compact", **changes: object) -> Trainer:
    settings = {"batch": 2, "draws": 1, "points": 256, "workers": 0, "device": "cpu"}
    config = TrainConfig(folder, preset=preset, steps=steps, **{**settings, **changes})
    return Trainer(config, Mixture(((ProceduralSource(), 1.0),), SampleConfig(points=256)))


def curve(folder: Path) -> list[float]:
    return [row["loss"] for row in read_rows(folder / "losses.csv")]


@pytest.mark.parametrize("steps", [8, pytest.param(50, marks=pytest.mark.slow)])
@pytest.mark.long
def test_the_same_seed_gives_the_same_curve(tmp_path, steps):
    trainer(tmp_path / "a", steps).run()
    trainer(tmp_path / "b", steps).run()
    trainer(tmp_path / "c", 3, seed=1).run()
    assert len(curve(tmp_path / "a")) == steps
    assert curve(tmp_path / "a") == curve(tmp_path / "b")
    assert curve(tmp_path / "c") != curve(tmp_path / "a")[:3]


@pytest.mark.parametrize("preset", ["compact", "compact-diffusion", "paper"])
@pytest.mark.long
def test_a_killed_run_ends_in_the_state_of_one_that_was_not(tmp_path, preset):
    """Killed at step 5 with the state of step 4 on disk: steps 4 and 5 are done again."""
    whole = trainer(tmp_path / "whole", 8, preset)
    whole.run()
    killed = trainer(tmp_path / "killed", 8, preset, save_every=4)
    killed._due = lambda every, run=killed: (
        _kill_at(run, 5) or (bool(every) and run.step % every == 0)
    )
    with pytest.raises(KeyboardInterrupt):
        killed.run()
    resumed = trainer(tmp_path / "killed", 8, preset, save_every=4)
    assert resumed.step == 4
    resumed.run()
    for name, value in whole.network.state_dict().items():
        assert torch.equal(value, resumed.network.state_dict()[name]), name
        assert torch.equal(whole.averaged[name], resumed.averaged[name]), name
    assert curve(tmp_path / "whole") == curve(tmp_path / "killed")


def _kill_at(run: Trainer, step: int) -> bool:
    """Stands for a kill: nothing after it is run, nothing is saved."""
    if run.step == step:
        raise KeyboardInterrupt
    return False


@pytest.mark.parametrize("workers", [0, 1])
def test_a_signal_to_all_processes_stops_after_the_step_and_saves(tmp_path, workers):
    run = trainer(tmp_path, 50, workers=workers)
    keep = run._one_step

    def step_then_signal(batch):
        loss = keep(batch)
        if run.step == 2:
            for process in (os.getpid(), *(c.pid for c in multiprocessing.active_children())):
                os.kill(process, signal.SIGTERM)
        return loss

    run._one_step = step_then_signal
    run.run()
    assert run.step == 2
    assert trainer(tmp_path, 50).step == 2
    for process in multiprocessing.active_children():
        process.join(20)
    assert not multiprocessing.active_children()


@pytest.mark.long
def test_the_best_weights_of_the_validation_are_kept(tmp_path):
    held_out = Mixture(((ProceduralSource(held_out=True), 1.0),), SampleConfig(points=256))
    validation = ValidationSet(held_out, 3, samples=2)
    config = TrainConfig(
        tmp_path, steps=4, batch=2, draws=1, points=256, workers=0, validate_every=2
    )
    mixture = Mixture(((ProceduralSource(), 1.0),), SampleConfig(points=256))
    Trainer(config, mixture, validation).run()
    rows = read_rows(tmp_path / "validation.csv")
    assert [row["step"] for row in rows] == [2, 4]
    best = read_checkpoint(tmp_path / "best.safetensors")
    winner = min(rows, key=lambda row: row["wta_mean_error"])
    assert best.about["step"] == str(int(winner["step"]))
    assert (tmp_path / "curves.png").stat().st_size > 1000


def test_mixed_precision_learns_in_full_precision_weights(tmp_path):
    run = trainer(tmp_path, 2, precision="bf16")
    before = {k: v.clone() for k, v in run.network.state_dict().items()}
    assert 0 < run.run() < 10
    after = run.network.state_dict()
    assert all(v.dtype == torch.float32 for v in after.values())
    assert any(not torch.equal(before[k], v) for k, v in after.items())


def test_a_run_can_begin_with_given_weights(tmp_path):
    first = trainer(tmp_path / "a", 2)
    first.run()
    second = trainer(tmp_path / "b", 2, init=str(tmp_path / "a" / "latest.safetensors"))
    for name, value in second.network.state_dict().items():
        assert torch.equal(value, first.averaged[name])


def test_the_command_trains_and_goes_on(tmp_path):
    common = ["--out", str(tmp_path), "--batch", "2", "--points", "256", "--workers", "0"]
    assert main([*common, "--steps", "2", "--validate-every", "0"]) == 0
    assert main([*common, "--steps", "3", "--validate-every", "0"]) == 0
    assert len(curve(tmp_path)) == 3
    assert read_checkpoint(tmp_path / "latest.safetensors").about == {
        "step": "3",
        "data": "procedural",
    }


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"preset": "huge"}, "preset must be one of"),
        ({"precision": "fp8"}, "precision must be"),
        ({"batch": 0}, "batch must be at least 1"),
    ],
)
def test_settings_out_of_range_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        TrainConfig(Path("x"), **change)


def test_the_rate_rises_stays_and_falls_to_zero():
    config = TrainConfig(Path("x"), steps=100, warmup=10, decay=0.2, rate=1.0)
    rates = [config.rate_at(step) for step in range(101)]
    assert rates[0] == pytest.approx(0.1)
    assert rates[20] == rates[70] == 1.0
    assert rates[90] == pytest.approx(0.5)
    assert rates[100] == 0.0


@pytest.mark.slow
def test_two_processes_train_together(tmp_path):
    command = [
        sys.executable,
        "-m",
        "torch.distributed.run",
        "--nproc-per-node",
        "2",
        "--master-port",
        "29511",
    ]
    command += [
        "-m",
        "flowbothd_model.training.train",
        "--out",
        str(tmp_path),
        "--steps",
        "3",
        "--batch",
        "2",
    ]
    command += ["--points", "256", "--workers", "0", "--validate-every", "0", "--device", "cpu"]
    subprocess.run(command, check=True, timeout=170, env={**os.environ, "OMP_NUM_THREADS": "1"})
    assert len(curve(tmp_path)) == 3


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_one_closed_four_mode_door_gives_all_four_modes(tmp_path):
    """Overfitting: 50 samples contain every mode with a cosine above 0.9."""
    from flowbothd_model.data.observation import Observation
    from flowbothd_model.data.sampling import Sample
    from flowbothd_model.evaluate import mode_flows
    from flowbothd_model.predictor import Predictor

    view = mode_flows(1, 512, jitter=0.0)  # a view that shows much of the leaf
    assert view is not None
    seen, modes = view

    class OneDoor(Mixture):
        def sample_at(self, batch: int, element: int) -> Sample:
            current = Observation(seen.points, modes[element % 4], seen.link)
            return Sample(current, None, "Door", "one", Situation.CLOSED)

    config = TrainConfig(
        tmp_path, steps=450, batch=4, draws=4, warmup=20, ema=0.95, workers=0, device="cpu"
    )
    run = Trainer(config, OneDoor(()))
    run.run()
    run.network.load_state_dict(run.averaged)
    predictor = Predictor(run.network, run.model_config, "overfit")
    flows = torch.from_numpy(predictor.sample(seen.points, samples=50, seed=0))
    for mode in modes:
        assert float(flow_errors(flows, torch.from_numpy(mode)).cosine.max()) > 0.9
