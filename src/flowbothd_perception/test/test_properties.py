"""Invariants of every frame: any scene, mount and arm pose, in every form of input."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flowbothd_common.transforms import look_at, rotation_about, transform
from flowbothd_perception.crop import to_base
from flowbothd_perception.depth import Lens, ray_table
from flowbothd_perception.frame import CloudFrame, DepthFrame, Optics
from flowbothd_perception.params import OutlierParams, PipelineParams, RobotFilterParams
from flowbothd_perception.pipeline import PerceptionPipeline, Verdict
from flowbothd_perception.robot_filter import RobotFilter
from flowbothd_perception.solids import Hull

H, W = 48, 64
LENS = Lens(W, H, (60.0, 0, 31.5, 0, 60.0, 23.5, 0, 0, 1))
SHAPE = (
    '<link name="{0}"><collision><origin xyz="{1}" rpy="0 0 0"/>'
    "<geometry>{2}</geometry></collision></link>"
)
URDF = (
    '<robot name="toy">'
    + SHAPE.format("base", "0 0 0.1", '<box size="0.2 0.2 0.2"/>')
    + SHAPE.format("arm", "0 0 0.3", '<cylinder radius="0.15" length="0.6"/>')
    + SHAPE.format("ball", "0 0 0", '<sphere radius="0.2"/>')
    + '<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>'
    '<origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    '<joint name="fixed" type="fixed"><parent link="arm"/><child link="ball"/>'
    '<origin xyz="0 0 0.6"/></joint></robot>'
)
"""Symmetric about the plane y = 0, whatever the joint's angle."""

BARE = RobotFilterParams(padding=0.02, padded_links=(), paddings=())
# Clusters depend on which pixels were drawn; every other verdict is about the pixel alone.
PLAIN = PipelineParams(robot=BARE, outliers=OutlierParams(cluster_tolerance=0.0))
KINDS = ("millimetres", "metres", "organised", "loose")


@dataclass(frozen=True)
class Seen:
    """A camera, what it measured, and the arm's joint."""

    T: np.ndarray
    depth: np.ndarray
    q: float

    def frame(self, kind):
        """Frame of a kind, and the (P, 3) points of its pixels, invalid ones NaN."""
        rays = ray_table(LENS)
        known = self.depth > 0
        points = np.full((H, W, 3), np.nan, np.float32)
        metres = self.depth.astype(np.float32) * np.float32(0.001)
        points[known] = np.dstack([rays * metres[..., None], metres])[known]
        if kind == "millimetres":
            return DepthFrame(self.depth, Optics(rays)), points.reshape(-1, 3)
        if kind == "metres":
            return DepthFrame(metres, Optics(rays)), points.reshape(-1, 3)
        if kind == "organised":
            return CloudFrame(points), points.reshape(-1, 3)
        return CloudFrame(points[known]), points[known]


@st.composite
def scenes(draw):
    """Slopes and steps with holes, seen from anywhere around the workspace."""
    seed = draw(st.integers(0, 10_000))
    around = draw(st.floats(-2.5, 2.5))
    roll = draw(st.sampled_from((0.0, 0.5 * np.pi, np.pi, 1.1)))
    rng = np.random.default_rng(seed)
    eye = (0.5 + 1.1 * np.cos(around), 1.1 * np.sin(around), rng.uniform(0.3, 1.1))
    T = look_at(eye, (0.45, 0.0, 0.3)) @ transform(rotation_about((0, 0, 1), roll))
    v, u = np.mgrid[:H, :W]
    depth = rng.uniform(0.6, 1.3) + 0.2 * np.sin(u / rng.uniform(8, 30)) + 0.003 * v
    depth[:, rng.integers(W) :] += rng.uniform(0.05, 0.4)
    depth += rng.normal(0, 0.002, depth.shape)
    depth[rng.random(depth.shape) < draw(st.sampled_from((0.0, 0.1, 0.9, 1.0)))] = 0
    return Seen(T, np.rint(1000 * depth).astype(np.uint16), float(rng.uniform(0.3, 2.0)))


@pytest.fixture(scope="module")
def pipeline():
    return PerceptionPipeline(PLAIN, URDF)


@settings(max_examples=30)
@given(seen=scenes(), kind=st.sampled_from(KINDS), seed=st.integers(0, 99))
def test_what_comes_out_went_in_bit_for_bit(pipeline, seen, kind, seed):
    frame, points = seen.frame(kind)
    result = pipeline.process(frame, seen.T, [seen.q], seed)
    assert len(set(result.pixels.tolist())) == len(result.pixels), "no point twice"
    before = frame.points(result.pixels)
    assert before.tobytes() == points[result.pixels].tobytes()
    np.testing.assert_allclose(result.points, to_base(seen.T, before), rtol=0, atol=1e-6)
    assert np.isfinite(result.points).all()


@settings(max_examples=30)
@given(seen=scenes(), kind=st.sampled_from(KINDS))
def test_cropping_again_takes_nothing_more(seen, kind):
    frame, points = seen.frame(kind)
    inside = frame.inside(seen.T, PLAIN.crop)
    left = np.full_like(points, np.nan)
    left[inside] = points[inside]
    if kind in ("organised", "loose"):
        again = CloudFrame(left.reshape(*frame.shape, 3) if kind == "organised" else left)
    else:
        depth = np.where(np.isfinite(left[:, 2]), seen.depth.reshape(-1), 0).reshape(H, W)
        again, _ = replace(seen, depth=depth.astype(np.uint16)).frame(kind)
    np.testing.assert_array_equal(again.inside(seen.T, PLAIN.crop), inside)


@settings(max_examples=20)
@given(seen=scenes(), padding=st.floats(0.0, 0.1), scale=st.floats(0.8, 1.3), shadow=st.booleans())
def test_filtering_again_takes_nothing_more(seen, padding, scale, shadow):
    _, points = seen.frame("loose")
    base, eye = to_base(seen.T, points), seen.T[:3, 3]
    robot = RobotFilter(URDF, replace(BARE, padding=padding, scale=scale, shadow=shadow))
    first = robot.on_robot(base, [seen.q], eye)
    assert not robot.on_robot(base[~first], [seen.q], eye).any()


@settings(max_examples=20)
@given(
    seen=scenes(),
    paddings=st.lists(st.floats(0.0, 0.12), min_size=2, max_size=3).map(sorted),
    scales=st.lists(st.floats(1.0, 1.4), min_size=3, max_size=3).map(sorted),
    shadow=st.booleans(),
)
def test_more_padding_or_scale_never_gives_a_point_back(seen, paddings, scales, shadow):
    _, points = seen.frame("loose")
    base, eye = to_base(seen.T, points), seen.T[:3, 3]
    found = [
        RobotFilter(
            URDF,
            replace(BARE, padding=p, scale=s, shadow=shadow, shadow_padding=p),
        ).on_robot(base, [seen.q], eye)
        for p, s in zip(paddings, scales[: len(paddings)], strict=True)
    ]
    for smaller, larger in pairwise(found):
        assert not (smaller & ~larger).any()


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), paddings=st.lists(st.floats(0, 0.1), min_size=3, max_size=4))
def test_padding_of_meshes_is_monotone(seed, paddings):
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(30, 3)) * rng.uniform(0.03, 0.2, 3)
    points = rng.normal(scale=0.2, size=(3000, 3)).astype(np.float32)
    found = [Hull(corners, p).contains(points) for p in sorted(paddings)]
    for smaller, larger in pairwise(found):
        assert not (smaller & ~larger).any()


def test_the_scenes_show_something(pipeline):
    """Guards the others: properties of empty pictures would say nothing."""
    found = np.zeros(len(Verdict), int)

    @settings(max_examples=30)
    @given(seen=scenes())
    def count(seen):
        there = verdicts(pipeline, seen.frame("millimetres")[0], seen.T, seen.q)
        found[:] += np.bincount(there.ravel(), minlength=len(Verdict))

    count()
    assert (found > 30 * 20).all(), found


def verdicts(pipeline, frame, T, q):
    return pipeline.process(frame, T, [q], whole=True).verdicts


@settings(max_examples=30)
@given(seen=scenes())
def test_mirroring_camera_and_world_mirrors_the_verdicts(pipeline, seen):
    """The picture flipped, the camera on the other side of the arm: each pixel judged the same."""
    flip = np.diag([1.0, -1.0, 1.0, 1.0])
    mirrored = flip @ seen.T @ np.diag([-1.0, 1.0, 1.0, 1.0])
    optics = Optics(ray_table(LENS))
    here = verdicts(pipeline, DepthFrame(seen.depth, optics), seen.T, seen.q)
    there = DepthFrame(np.ascontiguousarray(seen.depth[:, ::-1]), optics)
    np.testing.assert_array_equal(verdicts(pipeline, there, mirrored, seen.q)[:, ::-1], here)


@settings(max_examples=30)
@given(seen=scenes(), quarters=st.sampled_from((1, 2, 3)))
def test_turning_the_camera_on_its_axis_turns_the_verdicts(pipeline, seen, quarters):
    """The camera hung on its side or upside down: each pixel judged the same."""
    turned = seen.T @ transform(rotation_about((0, 0, 1), 0.5 * np.pi * quarters))
    lens = Lens(H, W, (60.0, 0, 23.5, 0, 60.0, 31.5, 0, 0, 1)) if quarters % 2 else LENS
    picture = np.ascontiguousarray(np.rot90(seen.depth, quarters))
    here = verdicts(pipeline, DepthFrame(seen.depth, Optics(ray_table(LENS))), seen.T, seen.q)
    there = verdicts(pipeline, DepthFrame(picture, Optics(ray_table(lens))), turned, seen.q)
    differ = np.rot90(there, -quarters) != here
    assert differ.sum() <= 3, "but for rounding on the border of the box or of a solid"


@settings(max_examples=30)
@given(seen=scenes())
def test_depth_images_and_clouds_are_judged_alike(pipeline, seen):
    found = {k: verdicts(pipeline, seen.frame(k)[0], seen.T, seen.q) for k in KINDS[:3]}
    for kind in KINDS[1:3]:
        assert (found[kind] != found["millimetres"]).sum() <= 3, kind
    known = seen.depth.ravel() > 0
    loose = verdicts(pipeline, seen.frame("loose")[0], seen.T, seen.q).ravel()
    image = found["millimetres"].ravel()[known]
    for verdict in (Verdict.OUTSIDE, Verdict.ROBOT):
        assert ((loose == verdict) != (image == verdict)).sum() <= 3, verdict
