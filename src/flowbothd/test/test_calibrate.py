"""`flowbothd calibrate` on captures of the simulated camera."""

import numpy as np
import pytest
import yaml

from flowbothd.cli import main
from flowbothd_common.errors import FlowBotError
from flowbothd_common.transforms import rotation_angle, rotation_from_quaternion
from flowbothd_evaluation.benchmarks.perception_scenes import MOUNTS, TruthScenes
from flowbothd_perception.calibration import captures as files
from flowbothd_perception.calibration.captures import Capture
from flowbothd_perception.depth import Lens
from franka_suction_driver.arm.description import compose_urdf
from sim_bridge.camera import Intrinsics
from sim_bridge.depth_noise import DepthNoise

NAMES = tuple(f"panda_joint{i}" for i in range(1, 8))
LENS = Intrinsics(320, 288, 252.0, 252.0, 159.5, 143.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Six poses of the arm before the door, with noise and flying pixels."""
    noise = DepthNoise(flying_fraction=0.3)
    scenes = TruthScenes(compose_urdf(), mounts=MOUNTS[:1], noise=noise, lens=LENS)
    lens = Lens(320, 288, (LENS.fx, 0.0, LENS.cx, 0.0, LENS.fy, LENS.cy, 0.0, 0.0, 1.0))
    path = tmp_path_factory.mktemp("captures")
    files.save(
        path,
        [
            Capture(NAMES, f.joint_positions, lens, np.rint(1000 * f.depth).astype(np.uint16))
            for f in scenes.still_life(6, seed=1)
        ],
    )
    return path


@pytest.mark.long
def test_the_tool_gives_the_pose_and_the_check_believes_it(folder, tmp_path, capsys):
    """The guess of a tape measure is 9 cm and a few degrees off."""
    out = tmp_path / "camera.yaml"
    guess = ["0.48", "-1.05", "0.68", "0.48", "0.05", "0.33"]
    command = ["calibrate", "tool", "--captures", str(folder), "--guess", *guess]
    assert main([*command, "--out", str(out)]) == 0
    values = yaml.safe_load(out.read_text())["/**/perception_node"]["ros__parameters"]
    truth = MOUNTS[0].T_base_camera
    np.testing.assert_allclose(values["camera.position"], truth[:3, 3], atol=0.004)
    turned = rotation_from_quaternion(values["camera.quaternion"]) @ truth[:3, :3].T
    assert np.degrees(rotation_angle(turned)) < 0.3
    assert "residual" in capsys.readouterr().out
    checking = ["calibrate", "check", "--captures", str(folder), "--parameters", str(out)]
    assert main(checking) == 0
    assert "fine" in capsys.readouterr().out
    values["camera.position"][2] += 0.02
    out.write_text(yaml.safe_dump({"perception_node": {"ros__parameters": values}}))
    assert main(checking) == 1
    said = capsys.readouterr().out
    assert "bad" in said
    assert 15 < float(said.split("seen ")[1].split(" mm")[0]) < 25


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["tool"], "needs a first guess"),
        (["tool", "--guess", *["0"] * 6], "describes no view"),
        (["board", "--square", "0.02"], "too few captures; got 0 of 6"),
        (["board"], "--square is missing"),
        (["board", "--board", "8x6", "--square", "0.02"], "turned by half"),
        (["check"], "not calibrated"),
    ],
)
def test_what_is_missing_is_said(folder, capsys, more, message):
    assert main(["calibrate", *more, "--captures", str(folder)]) == 2
    error = capsys.readouterr().err
    assert message.replace("; got 0 of 6", "") in error


@pytest.mark.ros
def test_captures_are_taken_where_the_arm_rests_and_nowhere_twice(monkeypatch):
    rclpy = pytest.importorskip("rclpy", reason="ROS is not installed")
    import array

    from rclpy.context import Context
    from sensor_msgs.msg import CameraInfo, Image, JointState

    from flowbothd_common.ros.conversions import to_stamp
    from flowbothd_perception.calibration.recorder_ros import CaptureNode
    from flowbothd_perception.params import CameraParams

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context, taken = Context(), []
    rclpy.init(context=context, domain_id=77)
    node = CaptureNode(CameraParams(), "ir/image_raw", taken.append, context=context)
    callbacks = {s.topic_name: s.callback for s in node.subscriptions}
    now = 10.0

    def image(kind, size):
        message = Image(height=3, width=4, encoding=kind, step=4 * size)
        message.data = array.array("B", bytes([7]) * 12 * size)
        message.header.stamp = to_stamp(now)
        return message

    try:
        k = [2.0, 0.0, 1.5, 0.0, 2.0, 1.0, 0.0, 0.0, 1.0]
        callbacks["/depth/camera_info"](CameraInfo(width=4, height=3, k=k))
        callbacks["/ir/image_raw"](image("mono16", 2))
        # At rest, moving, at rest elsewhere, and back where it was.
        for begin, end in ((0.0, 0.0), (0.0, 0.5), (0.5, 0.5), (0.5, 0.0), (0.0, 0.0)):
            for step in range(30):
                angle = begin + (end - begin) * step / 30
                message = JointState(name=["a"], position=[angle])
                message.header.stamp = to_stamp(now)
                callbacks["/joint_states"](message)
                callbacks["/depth/image_raw"](image("16UC1", 2))
                now += 0.04
        assert [round(float(c.joint_positions[0]), 2) for c in taken] == [0.0, 0.5]
        assert taken[0].picture.shape == (3, 4)
        assert taken[0].depth.dtype == np.uint16
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_an_unreadable_folder_is_an_error_of_ours(tmp_path):
    with pytest.raises(FlowBotError):
        files.load(tmp_path)
