"""`flowbothd bench sim`: camera, physics and whole runs of the stepped world."""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
import open3d as o3d

from flowbothd_evaluation.benchmarks.bench import (
    Timing,
    add_json_argument,
    measure,
    timing_table,
    write_timings,
)
from flowbothd_evaluation.rollout.arm import arm_rollout
from franka_suction_driver.arm.description import compose_urdf
from sim_bridge.camera import DepthCamera
from sim_bridge.depth_noise import DepthNoise
from sim_bridge.objects.registry import load_object
from sim_bridge.scene import tensor
from sim_bridge.scenes import Scene, scene_for
from sim_bridge.world import ArmWorld

REBUILT = "camera, scene rebuilt each frame (baseline)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd bench sim`."""
    parser.add_argument("--repetitions", type=int, default=100, help="(default: %(default)s)")
    parser.add_argument("--rollouts", type=int, default=2, help="whole runs (default: %(default)s)")
    add_json_argument(parser)


def _rebuilt(world: ArmWorld, camera: DepthCamera) -> None:
    """The same picture the plain way: all triangles into one new scene, all rays cast."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    poses = world.part_poses()
    for part in world.parts():
        mesh = part.mesh.transformed(poses[part.name])
        scene.add_triangles(
            tensor(mesh.vertices.astype(np.float32)), tensor(mesh.faces.astype(np.uint32))
        )
    rotation, eye = camera.T_base_camera[:3, :3], camera.T_base_camera[:3, 3]
    directions = camera.intrinsics.directions() @ rotation.T.astype(np.float32)
    rays = np.concatenate([np.broadcast_to(eye, directions.shape), directions], axis=-1)
    scene.cast_rays(tensor(rays.astype(np.float32)), nthreads=1)


def _timings(scene: Scene, repetitions: int) -> dict[str, Timing]:
    model = load_object(scene.object, mode="pull_left")
    with ArmWorld(compose_urdf(), model, scene.T_base_object) as world:
        parts = world.parts()
        exact = DepthCamera(parts, scene.T_base_camera)
        noisy = DepthCamera(parts, scene.T_base_camera, noise=DepthNoise())
        rng = np.random.default_rng(0)
        start = np.array(world.params.start)

        def moved(camera: DepthCamera) -> None:
            world.set_arm_positions(start + rng.uniform(-0.05, 0.05, len(start)))
            camera.render(world.part_poses())

        return measure(
            {
                REBUILT: lambda: _rebuilt(world, exact),
                "camera, persistent scenes, arm moving": lambda: moved(exact),
                "camera, persistent scenes, arm moving, noise": lambda: moved(noisy),
                "physics, 1 tick of 1/240 s": world.step,
                "ground-truth flow of 1200 points": lambda: world.ground_truth_flow(
                    rng.uniform((0.45, -0.05, 0.0), (0.65, 0.05, 0.45), (1200, 3))
                ),
            },
            repetitions,
        )


def run(arguments: argparse.Namespace) -> int:
    """Measure and print."""
    scene = scene_for("custom_door")
    timings = _timings(scene, arguments.repetitions)
    sys.stdout.write(timing_table(timings, REBUILT) + "\n\n")
    factors = []
    for seed in range(arguments.rollouts):
        began = time.perf_counter()
        record, _ = arm_rollout(scene, seed=seed, predictor="oracle")
        factors.append(record.summary().sim_s / (time.perf_counter() - began))
    if factors:
        sys.stdout.write(
            f"whole runs of the arm: {np.median(factors):.1f} times real time "
            f"(median of {len(factors)})\n"
        )
    write_timings(arguments.json, timings, rollout_real_time_factors=factors)
    return 0
