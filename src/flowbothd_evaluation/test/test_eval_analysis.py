"""Analyses of predictions: what they ask, and that known answers give the numbers they must."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
import torch

from flowbothd_common.types import Cloud, History
from flowbothd_evaluation.paper.analysis import ANALYSES, inputs
from flowbothd_evaluation.paper.analysis.chains import AmbiguousDoor, _arc, chains
from flowbothd_evaluation.paper.analysis.doors import (
    PAPER,
    closed_and_open,
    draw_closed_and_open,
    markdown_closed_and_open,
)
from flowbothd_evaluation.paper.analysis.history import (
    draw_history_filter,
    even_lengths,
    history_filter,
)
from flowbothd_evaluation.paper.analysis.inputs import Inputs, MissingInputError, OneAnswer
from flowbothd_evaluation.paper.analysis.multimodality import draw_multimodality, multimodality
from flowbothd_evaluation.paper.analysis.occlusion import (
    STEP,
    draw_occluded_flows,
    draw_occlusion,
    occlusion,
)
from flowbothd_evaluation.paper.analysis.rollouts import _captioned, draw_rollout, telling_runs
from flowbothd_evaluation.paper.analysis.run import run_analyses
from flowbothd_evaluation.paper.analysis.setting import Setting, main_joint, most_occluded
from flowbothd_evaluation.paper.analysis.showcases import ways
from flowbothd_evaluation.rollout.floating import FLOATING_POLICY, floating_rollout
from flowbothd_evaluation.run_record.signals import pull_signals
from flowbothd_model.checkpoint import Checkpoint
from flowbothd_model.config import PRESETS
from flowbothd_model.data.articulated import ArticulatedObject, JointKind, LinkJoint
from flowbothd_model.data.procedural.catalogue import HELD_OUT_FROM, make
from flowbothd_model.data.splits import NEVER_TRAINED_ON, held_out_ids
from flowbothd_model.network.factory import build
from flowbothd_model.predictor import Predictor
from sim_bridge.objects.registry import load_object


@dataclass
class Knowing:
    """A predictor that knows the truth of its object, and what it was asked.

    Without a history every second answer is the truth's opposite. With one it goes on as the
    history went: right after a right flow, wrong after a wrong one.
    """

    setting: Setting
    both: bool = True
    model_id: str = "knowing"
    asked: list[History | None] = field(default_factory=list)

    def truth(self, points: Cloud) -> Cloud:
        """The flow of a leaf that turns about its hinge: nothing else of the door moves."""
        item = self.setting.item
        found = self.setting.known[points.tobytes()]  # type: ignore[attr-defined]
        assert item.movable
        return found

    def sample(
        self,
        points: Cloud,
        history: History | None = None,
        samples: int = 1,
        steps: int | None = None,
        sampler: str | None = None,
        seed: int | None = None,
    ) -> np.ndarray:
        self.asked.append(history)
        truth = self.truth(points)
        if history is not None:
            went = float((history.flow * self.truth(history.points)).sum())
            return np.repeat(np.sign(went) * truth[None], samples, axis=0).astype(np.float32)
        signs = np.where(self.both & (np.arange(samples) % 2 == 1), -1.0, 1.0)
        return (signs[:, None, None] * truth).astype(np.float32)


class Remembered(Setting):
    """A setting that keeps the truth of every cloud it has shown."""

    def see(self, ratio: float, seed: int, points: int = 1200):  # type: ignore[no-untyped-def]
        seen = super().see(ratio, seed, points)
        if seen is not None:
            self.known[seen.points.tobytes()] = seen.flow
        return seen

    @property
    def known(self) -> dict[bytes, Cloud]:
        return _KNOWN.setdefault(self.item.name, {})


_KNOWN: dict[str, dict[bytes, Cloud]] = {}


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Two threads of torch wait for each other on a busy machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def door() -> Remembered:
    item = make("Door", HELD_OUT_FROM + 1)
    return Remembered(item, main_joint(item))


def box(low: Sequence[float], high: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an axis-aligned box."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    vertices = np.asarray(low) + corners * (np.asarray(high) - np.asarray(low))
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return vertices, np.array(faces, dtype=np.int64)


def knobbed() -> ArticulatedObject:
    """A body with a wide drawer and, named first, a small knob."""
    shapes = [
        box((0, -0.5, 0), (0.5, 0.5, 1)),
        box((-0.05, 0.3, 0.8), (0, 0.35, 0.85)),
        box((-0.05, -0.4, 0.2), (0, 0.4, 0.6)),
    ]
    vertices = np.concatenate([v for v, _ in shapes]).astype(np.float32)
    faces = np.concatenate([f + 8 * i for i, (_, f) in enumerate(shapes)])
    joints = (
        LinkJoint(),
        LinkJoint(0, JointKind.REVOLUTE, (1, 0, 0), (0, 0.32, 0.82), 0.0, 6.28, "knob"),
        LinkJoint(0, JointKind.PRISMATIC, (-1, 0, 0), (0, 0, 0), 0.0, 0.4, "drawer"),
    )
    return ArticulatedObject("knobbed", "Oven", vertices, faces, np.repeat([0, 1, 2], 8), joints)


def test_the_camera_stands_where_the_published_one_does():
    setting = Setting(knobbed(), 2)
    from_world = setting.view().T_camera_object.copy()
    eye = -from_world[:3, :3].T @ from_world[:3, 3]
    np.testing.assert_allclose(eye, (-2.0, 0.0, 2.0 - setting.lift), atol=1e-9)


def test_the_part_that_is_meant_is_the_large_one():
    """An oven's knobs turn too; they come first in some files."""
    assert main_joint(knobbed()) == 2


def test_opening_moves_the_main_joint_alone_and_clouds_repeat():
    setting = Setting(knobbed(), 2)
    np.testing.assert_allclose(setting.positions(0.5), (0.0, 0.0, 0.2))
    first, again, other = setting.see(0.5, 1), setting.see(0.5, 1), setting.see(0.5, 2)
    assert first is not None
    assert again is not None
    assert other is not None
    np.testing.assert_array_equal(first.points, again.points)
    assert not np.array_equal(first.points, other.points)
    assert setting.on_part(first) == int((first.link == 2).sum()) > 0


def test_the_occluding_camera_hides_the_part_at_some_opening(door: Remembered):
    """It is chosen among the published ones, and hides no less than the one straight in front."""
    ratios = (0.3, 0.6)
    turned = most_occluded(door, ratios, 3)
    assert 30.0 <= turned.azimuth <= 150.0
    assert turned.elevation == 30.0

    def least(setting: Setting) -> float:
        closed = setting.see(0.0, 3)
        seen = [setting.see(ratio, 3) for ratio in ratios]
        assert closed is not None
        counts = [setting.on_part(one) if one is not None else 0 for one in seen]
        return min(counts) / setting.on_part(closed)

    assert least(turned) <= least(replace(turned, azimuth=90.0))


def test_both_rules_count_right_and_opposite_answers(door: Remembered, tmp_path: Path):
    both = multimodality([door], {"flowbothd": Knowing(door)}, samples=6)
    assert both["shares"]["flowbothd"]["Door"]["paper_rule"] == 1.0
    assert both["shares"]["flowbothd"]["Door"]["code_rule"] == 1.0
    assert both["objects"][0]["right_by_cosine"] == pytest.approx(0.5)
    right = multimodality([door], {"flowbothd": Knowing(door, both=False)}, samples=6)
    assert right["shares"]["flowbothd"]["all"]["paper_rule"] == 0.0
    assert right["shares"]["flowbothd"]["all"]["code_rule"] == 0.0
    draw_multimodality(both, tmp_path / "m.png")
    assert 5_000 < (tmp_path / "m.png").stat().st_size <= 200_000


def test_the_best_sample_of_one_who_knows_is_perfect(door: Remembered, tmp_path: Path):
    knowing = Knowing(door)
    data = closed_and_open([door], {"flowbothd": knowing}, ratios=(0.0, 0.4), samples=4)
    rows = {row["state"]: row for row in data["rows"]}
    assert set(rows) == {"closed", "open", "open without history"}
    for row in rows.values():
        assert row["cosine"] == pytest.approx(1.0, abs=1e-3)
        assert row["mean_error"] == pytest.approx(0.0, abs=1e-3)
        assert row["rmse"] == pytest.approx(0.0, abs=1e-3)
    # Closed doors have no history; open ones have the truth of a tenth before.
    assert [history is None for history in knowing.asked] == [True, False, True]
    table = markdown_closed_and_open(data)
    assert f"({PAPER['flowbothd']['closed']['cosine']:.3f})" in table
    draw_closed_and_open(data, tmp_path / "d.png")
    assert (tmp_path / "d.png").stat().st_size > 5_000


def test_histories_are_none_true_good_and_bad(door: Remembered, tmp_path: Path):
    knowing = Knowing(door)
    data = history_filter([(door, 0.4)], knowing, samples=8)
    assert data["skipped"] == []
    medians = {kind: values["cosine"] for kind, values in data["medians"].items()}
    assert medians["true"] == pytest.approx(1.0, abs=1e-3)
    assert medians["good"] == pytest.approx(1.0, abs=1e-3)
    assert medians["bad"] == pytest.approx(-1.0, abs=1e-3)
    assert medians["none"] == pytest.approx(0.0, abs=1e-3)
    draw_history_filter(data, (door, 0.4), knowing, tmp_path / "h.png")
    assert (tmp_path / "h.png").stat().st_size > 5_000


def test_even_lengths_keep_direction_and_lose_the_hinge(door: Remembered):
    seen = door.see(0.4, 1)
    assert seen is not None
    even, moving = even_lengths(seen), np.linalg.norm(seen.flow, axis=1) > 1e-6
    np.testing.assert_allclose(np.linalg.norm(even[moving], axis=1), 1.0, atol=1e-5)
    np.testing.assert_array_equal(even[~moving], 0.0)
    assert (even[moving] * seen.flow[moving]).sum(1).mean() > 0.3


def test_a_cloud_without_a_bad_prediction_is_listed_as_skipped(door: Remembered):
    data = history_filter([(door, 0.4)], Knowing(door, both=False), samples=4)
    assert data["clouds"] == []
    assert "bad" in data["skipped"][0]["why"]


def test_occlusion_gives_the_history_that_it_says(door: Remembered, tmp_path: Path):
    knowing, baseline = Knowing(door), Knowing(door, both=False)
    ratios = tuple(np.linspace(0, 1, 6))
    predictors = {"flowbothd": knowing, "flowbot3d-md": baseline}
    data = occlusion([door], predictors, ratios=ratios, samples=2)
    entry = data["objects"][0]
    assert [(c["method"], c["history"]) for c in entry["curves"]] == [
        ("flowbothd", "true"),
        ("flowbothd", "own"),
        ("flowbothd", "none"),
        ("flowbot3d-md", "none"),
    ]
    true, own, none, other = entry["curves"]
    assert true["cosine"]["mean"][1:] == pytest.approx([1.0] * 5, abs=1e-3)
    assert own["cosine"]["mean"][1:] == pytest.approx([1.0] * 5, abs=1e-3)
    assert none["cosine"]["mean"] == pytest.approx([0.0] * 6, abs=1e-3)
    assert other["rmse"]["mean"] == pytest.approx([0.0] * 6, abs=1e-3)
    assert all(history is None for history in baseline.asked)
    first = knowing.asked[: len(ratios)]
    assert first[0] is None
    # The history of an opening is the cloud of STEP openings before, at the earliest the first.
    view = Setting(door.item, door.joint, entry["azimuth_deg"], entry["elevation_deg"])
    assert first[STEP + 1] is not None
    known = [h.points.tobytes() for h in first[1:] if h is not None]
    assert known[0] == known[STEP - 1]
    assert known[STEP] != known[0]
    assert view.see(0.0, 0) is not None
    draw_occlusion(data, tmp_path / "o.png")
    turned = Remembered(door.item, door.joint)
    draw_occluded_flows([turned], {"flowbot3d-md": _Still()}, data, tmp_path / "f.png")
    for name in ("o.png", "f.png"):
        assert 5_000 < (tmp_path / name).stat().st_size <= 200_000


class _Still:
    """A predictor whose flow is the same everywhere."""

    model_id = "still"

    def sample(self, points, history=None, samples=1, steps=None, sampler=None, seed=None):
        self.samples = samples
        return np.tile(np.float32([-1, 0, 0]), (samples, len(points), 1))


def test_like_answers_are_one_way_and_the_commonest_comes_first():
    rng = np.random.default_rng(0)
    fields = np.stack([np.tile(v, (50, 1)) for v in np.eye(3)])
    drawn = fields[[0, 1, 1, 2, 1, 0]] + 0.01 * rng.normal(size=(6, 50, 3))
    groups = ways(drawn.astype(np.float32))
    assert [share for _, share in groups] == pytest.approx([3 / 6, 2 / 6, 1 / 6])
    assert groups[0][0] in (1, 2, 4)


def test_one_answer_is_asked_for_once_and_repeated():
    still = _Still()
    flows = OneAnswer(still).sample(np.zeros((7, 3), np.float32), samples=5)
    assert flows.shape == (5, 7, 3)
    assert still.samples == 1


def fresh(preset: str) -> Checkpoint:
    """Untrained weights of a preset."""
    config = replace(PRESETS[preset], sampling_steps=min(PRESETS[preset].sampling_steps, 3))
    network = build(config.network, torch.Generator().manual_seed(4))
    tensors = network.state_dict()
    generator = torch.Generator().manual_seed(5)
    # Layers that begin at zero would answer the same to every draw.
    noisy = {
        name: t + 0.05 * torch.randn(t.shape, generator=generator) if t.is_floating_point() else t
        for name, t in tensors.items()
    }
    return Checkpoint(config, noisy, {})


@pytest.mark.parametrize("preset", ["compact", "compact-diffusion"])
def test_the_end_of_a_way_is_what_the_predictor_answers(preset: str):
    """Otherwise the pictures would show another process than the one that is used."""
    from flowbothd_evaluation.paper.analysis.measure import seed_of

    checkpoint, door = fresh(preset), AmbiguousDoor.make(0)
    data, found = chains(checkpoint, door, tries=4, seed=2)
    predictor = Predictor(checkpoint.network(), checkpoint.config, "fresh")
    answers = predictor.sample(door.seen.points, samples=4, seed=seed_of(2, 5))
    for way in found.fields:
        nearest = np.abs(answers - way[-1]).max(axis=(1, 2)).min()
        assert nearest < 1e-3
    assert len(data["agreement"][0]) == len(found.places) == len(data["places"])
    again, _ = chains(checkpoint, door, tries=4, seed=2)
    assert again == data


def test_a_model_that_draws_nothing_has_no_way_to_show():
    with pytest.raises(ValueError, match="draws nothing"):
        chains(fresh("compact-no-diffusion"), AmbiguousDoor.make(0))


def test_agreement_tells_left_from_right():
    """Point by point all pulls of a closed door have the same direction: the cosine is blind."""
    door = AmbiguousDoor.make(0)
    agreement = door.agreement(torch.from_numpy(door.flows))
    np.testing.assert_allclose(np.diag(agreement), 1.0, atol=1e-5)
    assert agreement[0, 1] < 0.8
    assert agreement[0, 2] < 0.0


def test_the_arc_begins_and_ends_in_its_vectors():
    generator = torch.Generator().manual_seed(1)
    start, end = torch.randn(2, 8, generator=generator)
    arc = _arc(start, end, np.linspace(0, 1, 9))
    torch.testing.assert_close(arc[0], start, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(arc[-1], end, atol=1e-4, rtol=1e-4)
    lengths = arc.norm(dim=1)
    assert float(lengths.min()) >= float(min(start.norm(), end.norm())) - 1e-4


def test_a_run_is_told_by_its_pulls_and_what_they_reached(tmp_path: Path):
    """The incident: signals of the floating gripper lagged a pull behind and ended at 0.8."""
    model = load_object("cabinet_door", seed=1)
    record = floating_rollout(model, FLOATING_POLICY)
    assert record.summary().success
    reached = pull_signals(record).open_ratio
    assert len(reached) == record.summary().steps
    assert reached[0] > 0.05
    assert reached[-1] == pytest.approx(record.open_ratio)
    assert (np.diff(reached) > -1e-3).all()
    shown = _captioned(record, 30)
    pulls = [caption for caption, _ in shown if caption.startswith("pull")]
    assert len(pulls) == len(reached)
    assert shown[-1][0].startswith("opened")
    assert len(_captioned(record, 3)) == 3
    draw_rollout(model, record, tmp_path / "run.png")
    assert 10_000 < (tmp_path / "run.png").stat().st_size <= 200_000


def test_the_told_runs_are_the_easiest_and_the_hardest():
    model = load_object("cabinet_door", seed=1)
    runs = [(model, _Run(steps=s, grasps=g, success=ok)) for s, g, ok in _RUNS]
    told = telling_runs(runs)  # type: ignore[arg-type]
    assert [one.grasps for _, one in told] == [1, 4]
    assert telling_runs([(model, _Run(0, 0, False))]) == []  # type: ignore[list-item]


_RUNS = ((4, 2, True), (4, 1, True), (9, 4, True), (30, 9, False))


@dataclass
class _Run:
    """What `telling_runs` reads of a record."""

    steps: int
    grasps: int
    success: bool

    resamples: int = 0

    def summary(self) -> _Run:
        return self


def test_without_weights_every_analysis_says_why_it_was_skipped(tmp_path: Path):
    results = run_analyses(None, {"flowbothd": "no-such-weights"}, tmp_path / "out")
    assert set(results["analyses"]) == set(ANALYSES)
    assert "recorded clouds" in results["analyses"].pop("recorded_clouds")["skipped"]
    for entry in results["analyses"].values():
        assert "no-such-weights" in entry["skipped"]
    assert json.loads((tmp_path / "out" / "analyses.json").read_text())["small"] is True
    assert str(tmp_path) not in (tmp_path / "out" / "analyses.json").read_text()


def test_an_unknown_analysis_is_refused_with_the_known_ones(tmp_path: Path):
    with pytest.raises(ValueError, match="occlusion"):
        run_analyses(None, {}, tmp_path, only=("oclusion",))


def test_missing_weights_are_named():
    with pytest.raises(MissingInputError, match="no weights given for flowbothd"):
        Inputs(None, {}).main()


def test_no_object_of_the_analyses_was_ever_trained_on():
    named = [*inputs._DOORS, *inputs._MORE_OCCLUDED, *inputs._FURNITURE]
    named += [*inputs._HALF_OPEN, *inputs._MORE_HALF_OPEN]
    named += [name for names in inputs._OCCLUDED.values() for name in names]
    assert set(named) <= {*held_out_ids(), *NEVER_TRAINED_ON}
    made = inputs.Inputs(None, {}).closed(small=True)
    assert all(int(s.item.name.rpartition("-")[2]) >= HELD_OUT_FROM for s in made)


@pytest.mark.long
def test_analyses_without_partnet_objects_are_written(tmp_path: Path):
    only = ("chains", "showcases")
    out = tmp_path / "out"
    results = run_analyses(None, {"flowbothd": "compact"}, out, only=only)["analyses"]
    for name in only:
        for _, file in results[name]["figures"]:
            assert 10_000 < (out / file).stat().st_size <= 200_000
    assert "no weights given for diffusion" in results["chains"]["data"]["diffusion"]["skipped"]
    written = (out / "analyses.json").read_text()
    assert json.loads(written)["analyses"].keys() == set(only)
    assert "NaN" not in written
