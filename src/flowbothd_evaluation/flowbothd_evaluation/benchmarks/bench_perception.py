"""`flowbothd bench perception`: the cores, the node at camera rate, and every pixel's truth."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, cast

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from flowbothd_common.markdown import markdown_table
from flowbothd_evaluation.benchmarks.bench import (
    Timing,
    add_json_argument,
    measure,
    timing_table,
    write_timings,
)
from flowbothd_evaluation.benchmarks.perception_load import Load, LoadFigures, run_load
from flowbothd_evaluation.benchmarks.perception_scenes import MOUNTS, TruthFrame, TruthScenes
from flowbothd_evaluation.benchmarks.perception_truth import KINDS, TruthCheck, TruthReport, compare
from flowbothd_perception.frame import CloudFrame, DepthFrame, Optics
from flowbothd_perception.params import CropParams, PipelineParams
from flowbothd_perception.pipeline import PerceptionPipeline
from franka_suction_driver.arm.description import compose_urdf
from sim_bridge.camera import Intrinsics
from sim_bridge.depth_noise import DepthNoise

PLAIN = "Open3D: crop, statistical outlier removal (baseline)"
NOISE = DepthNoise(flying_fraction=0.3)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd bench perception`."""
    parser.add_argument("--repetitions", type=int, default=30, help="(default: %(default)s)")
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="of the node at 30 Hz; 0 = leave it out"
    )
    parser.add_argument("--input", choices=("depth", "cloud"), default="depth", help="of the node")
    parser.add_argument(
        "--truth", type=int, default=0, metavar="N", help="arm poses to compare with the truth"
    )
    parser.add_argument("--seed", type=int, default=0, help="of poses, objects, noise")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Measure and print."""
    urdf = compose_urdf()
    scenes = TruthScenes(urdf, mounts=MOUNTS[:1], noise=NOISE)
    frames = list(scenes.frames(10, arguments.seed))
    more: dict[str, Any] = {}
    timings = core_timings(urdf, frames, scenes.lens, arguments.repetitions)
    sys.stdout.write(timing_table(timings, PLAIN) + "\n")
    if arguments.seconds > 0:
        load = Load(arguments.input, arguments.seconds)
        figures = run_load(load, urdf, frames)
        more["node"] = asdict(figures)
        sys.stdout.write("\n" + load_table(load, figures) + "\n")
    if arguments.truth:
        truth = truth_reports(urdf, arguments.truth, arguments.seed)
        more["truth"] = {name: report.as_dict() for name, report in truth.items()}
        sys.stdout.write("\n" + truth_table(truth) + "\n")
    write_timings(arguments.json, timings, **more)
    return 0


def core_timings(
    urdf: str, frames: list[TruthFrame], lens: Intrinsics, repetitions: int
) -> dict[str, Timing]:
    """The pipeline on every kind of input, and a plain Open3D one, on the same frames in turn."""
    pipeline, params = PerceptionPipeline(PipelineParams(), urdf), PipelineParams()
    directions = lens.directions()
    optics = Optics(np.ascontiguousarray(directions[..., :2]))
    images = [np.rint(1000.0 * frame.depth).astype(np.uint16) for frame in frames]
    clouds = [
        directions * np.where(f.depth > 0, f.depth, np.float32(np.nan))[..., None] for f in frames
    ]
    loose = [cloud[np.isfinite(cloud[..., 2])] for cloud in clouds]
    turn = {"at": 0}

    def each(process: Callable[[int, TruthFrame], object]) -> Callable[[], object]:
        def operation() -> object:
            turn["at"] += 1
            index = turn["at"] % len(frames)
            return process(index, frames[index])

        return operation

    def ours(make: Callable[[int], Any], *, whole: bool = False) -> Callable[[], object]:
        return each(
            lambda i, frame: pipeline.process(
                make(i), frame.mount.T_base_camera, frame.joint_positions, i, whole=whole
            )
        )

    return measure(
        {
            PLAIN: each(lambda i, f: plain(images[i], f.mount.T_base_camera, lens, params.crop)),
            "depth image to object cloud": ours(lambda i: DepthFrame(images[i], optics)),
            "organised cloud to object cloud": ours(lambda i: CloudFrame(clouds[i])),
            "loose cloud to object cloud": ours(lambda i: CloudFrame(loose[i])),
            "depth image, every pixel judged": ours(
                lambda i: DepthFrame(images[i], optics), whole=True
            ),
        },
        repetitions,
    )


def plain(depth: NDArray[Any], T_base_camera: np.ndarray, lens: Intrinsics, box: CropParams) -> Any:
    """What Open3D's tutorials lead to: back-project, transform, crop, statistical outlier removal.

    The robot stays in, and nothing is sampled. Neighbours and ratio are those of the tutorial.
    """
    geometry = o3d.geometry
    intrinsics = o3d.camera.PinholeCameraIntrinsic(
        lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy
    )
    image: Any = geometry.Image(cast("Any", depth))
    cloud = geometry.PointCloud.create_from_depth_image(
        image,
        intrinsics,
        depth_scale=1000.0,
        depth_trunc=3.0,
    )
    cloud.transform(T_base_camera)
    cloud = cloud.crop(geometry.AxisAlignedBoundingBox(box.min_corner, box.max_corner))
    return cloud.remove_statistical_outlier(nb_neighbors=20, std_ratio=2.0)[0]


def truth_reports(urdf: str, poses: int, seed: int) -> dict[str, TruthReport]:
    """The figures of every kind of input, exact, and with noise and a wrong calibration."""
    exact, noisy = TruthScenes(urdf), TruthScenes(urdf, noise=NOISE)
    checks = {kind: TruthCheck(urdf, exact.lens.directions(), kind=kind) for kind in KINDS}
    right = compare(exact.frames(poses, seed), checks)
    wrong = compare(noisy.frames(poses, seed), checks, metres=0.01, degrees=0.5, seed=seed)
    return {f"{kind}, exact": right[kind] for kind in KINDS} | {
        f"{kind}, noise, 1 cm and 0.5 degrees off": wrong[kind] for kind in KINDS
    }


_TRUTH_HEAD = (
    *("input", "robot removed", "worst mount", "object kept", "worst object"),
    *("kept after the crop", "flying removed", "surface kept"),
)


def truth_table(reports: Mapping[str, TruthReport]) -> str:
    """Markdown table of the shares, in total and for the worst object and mount."""
    rows = []
    for name, report in reports.items():
        s = report.total.shares()
        mount = min(t.shares()["robot_removed"] for t in report.by_mount.values())
        thing = min(t.shares()["object_kept"] for t in report.by_object.values())
        cells = (
            s["robot_removed"],
            mount,
            s["object_kept"],
            thing,
            s["object_kept_with_crop"],
            s["flying_removed"],
            s["surface_kept"],
        )
        rows.append((name, *(f"{100 * c:.2f} %" for c in cells)))
    return markdown_table(_TRUTH_HEAD, rows)


def load_table(load: Load, figures: LoadFigures) -> str:
    """Markdown table of the node's figures."""
    rows = (
        ("frames sent", f"{figures.sent}"),
        ("frames that reached the node", f"{figures.reached}"),
        ("frames answered", f"{figures.answered}"),
        ("message in to cloud out, median", f"{figures.inside_median_ms:.1f} ms"),
        ("message in to cloud out, p99", f"{figures.inside_p99_ms:.1f} ms"),
        ("sent to cloud received, median", f"{figures.outside_median_ms:.1f} ms"),
        ("sent to cloud received, p99", f"{figures.outside_p99_ms:.1f} ms"),
        ("of one core's time", f"{100 * figures.cpu_share:.0f} %"),
    )
    head = f"perception_node, {load.kind} at {load.rate:g} Hz for {load.seconds:g} s"
    return markdown_table((head, ""), rows)
