"""Turn a depth image of your own camera into the object cloud that the network sees.

    python examples/use_your_camera.py                     # a picture of the simulated camera
    python examples/use_your_camera.py --depth depth.npy --position 0.62 -1.0 0.65 --out cloud.npy

The image is (H, W), uint16 in millimetres or float32 in metres. The cloud is in the base frame of
the robot, cropped to the workspace, without the robot and without outliers.
"""

import argparse
from pathlib import Path

import numpy as np

from flowbothd_common.transforms import look_at
from flowbothd_perception.depth import Lens, ray_table
from flowbothd_perception.frame import DepthFrame, Optics
from flowbothd_perception.params import PipelineParams
from flowbothd_perception.pipeline import PerceptionPipeline
from franka_suction_driver.arm.description import compose_urdf
from franka_suction_driver.params import MotionParams
from sim_bridge.camera import DepthCamera
from sim_bridge.objects.registry import load_object
from sim_bridge.scenes import scene_for
from sim_bridge.world import ArmWorld

SCENE = scene_for("drawer")


def simulated_depth() -> np.ndarray:
    """Return (H, W) uint16 [mm]: a drawer and the arm, from the pose that is the default here."""
    with ArmWorld(compose_urdf(), load_object(SCENE.object), SCENE.T_base_object) as world:
        camera = DepthCamera(world.parts(), SCENE.T_base_camera)
        return camera.render(world.part_poses()).millimetres()


def main() -> None:
    """Print how many points are left after each stage, and write the cloud."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--depth", type=Path, help=".npy file")
    parser.add_argument("--intrinsics", type=float, nargs=4, default=[504, 504, 319.5, 287.5])
    parser.add_argument("--position", type=float, nargs=3, default=SCENE.camera_eye, help="[m]")
    parser.add_argument("--target", type=float, nargs=3, default=SCENE.camera_target, help="[m]")
    parser.add_argument("--out", type=Path, default="cloud.npy", help="(default: %(default)s)")
    given = parser.parse_args()

    depth = np.load(given.depth) if given.depth else simulated_depth()
    fx, fy, cx, cy = given.intrinsics
    lens = Lens(depth.shape[1], depth.shape[0], (fx, 0, cx, 0, fy, cy, 0, 0, 1))
    frame = DepthFrame(depth, Optics(ray_table(lens)))
    pipeline = PerceptionPipeline(PipelineParams(), compose_urdf())
    T_base_camera = look_at(given.position, given.target)  # or the matrix of your calibration
    joints = MotionParams().robot.start_positions  # those of your arm when the image was taken
    result = pipeline.process(frame, T_base_camera, joints)
    print("points after each stage:", result.counts, result.message)
    np.save(given.out, result.points)


if __name__ == "__main__":
    main()
