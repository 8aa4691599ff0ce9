"""Messages of every layout that the usual drivers send, whole and damaged."""

from __future__ import annotations

import array
from importlib.resources import files

import numpy as np
import pytest
import yaml

from flowbothd_common.errors import FrameUnavailableError, InvalidCloudError
from flowbothd_common.parameters import build, specifications
from flowbothd_perception.params import PerceptionNodeParams

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(0.2, 1.0, (6, 8, 3)).astype(np.float32)


def cloud(points, step=16, order="xyz", junk=np.nan, frame="camera", pad_row=0):
    """PointCloud2 with any point step; what lies between the fields is junk."""
    from sensor_msgs.msg import PointCloud2, PointField
    from std_msgs.msg import Header

    height, width = points.shape[:2]
    raw = np.full((height, width * step // 4 + pad_row // 4), junk, np.float32)
    names = [*order, *(["rgb"] if step >= 20 else [])]
    offsets = {name: 4 * i for i, name in enumerate(order)} | {"rgb": 16}
    for i, name in enumerate("xyz"):
        raw[:, offsets[name] // 4 : width * step // 4 : step // 4] = points[..., i]
    fields = [
        PointField(name=n, offset=offsets[n], datatype=PointField.FLOAT32, count=1) for n in names
    ]
    message = PointCloud2(
        header=Header(frame_id=frame),
        height=height,
        width=width,
        fields=fields,
        point_step=step,
        row_step=step * width + pad_row,
        is_dense=False,
    )
    message.data = array.array("B", raw.tobytes())
    return message


def read(message, **options):
    from rclpy.serialization import serialize_message

    from flowbothd_perception.images_ros import FrameReader
    from flowbothd_perception.raw_cloud_ros import read_cloud

    reader = FrameReader(**options)
    return reader, reader.read(read_cloud(serialize_message(message)))


@pytest.mark.parametrize("step", [12, 16, 20, 32, 48])
@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("junk", [np.nan, 0.0, 7.0])
def test_every_point_step_gives_the_same_points(step, flat, junk):
    points = POINTS.reshape(1, -1, 3) if flat else POINTS
    _, frame = read(cloud(points, step, junk=junk))
    assert frame.shape == points.shape[:2]
    np.testing.assert_array_equal(frame.points(np.arange(48)), POINTS.reshape(-1, 3))


def test_fields_in_any_order_and_rows_with_padding():
    _, frame = read(cloud(POINTS, 16, order="zxy", pad_row=64))
    np.testing.assert_array_equal(frame.points(np.arange(48)), POINTS.reshape(-1, 3))


def test_a_flattened_cloud_gets_its_shape_back_from_the_intrinsics():
    from sensor_msgs.msg import CameraInfo

    message = cloud(POINTS.reshape(1, -1, 3))
    reader, loose = read(message)
    assert loose.shape == (1, 48)
    reader.learn(CameraInfo(width=8, height=6, k=[5.0, 0.0, 3.5, 0.0, 5.0, 2.5, 0.0, 0.0, 1.0]))
    assert reader.read(message).shape == (6, 8)
    assert reader.read(cloud(POINTS.reshape(1, -1, 3)[:, :40])).shape == (1, 40)


def test_bytes_say_what_the_message_says():
    """Read straight from its bytes, a cloud is the same as through rclpy."""
    from rclpy.serialization import serialize_message

    from flowbothd_common.ros import clouds
    from flowbothd_perception.raw_cloud_ros import read_cloud

    for frame in ("", "a", "depth_camera_link", "kamera_ü"):
        for step in (16, 20, 32):
            message = cloud(POINTS, step, frame=frame)
            message.header.stamp.sec, message.header.stamp.nanosec = -3, 123456789
            raw = read_cloud(serialize_message(message))
            for name in ("height", "width", "point_step", "row_step", "is_dense", "header"):
                assert getattr(raw, name) == getattr(message, name), name
            assert list(raw.fields) == list(message.fields)
            assert bytes(raw.data) == message.data.tobytes()
            np.testing.assert_array_equal(
                clouds.from_cloud_message(raw, clouds.XYZ),
                clouds.from_cloud_message(message, clouds.XYZ),
            )
            assert read_cloud(message) is message


@pytest.mark.parametrize("kept", [5, 30, 60, 200, 700])
def test_damaged_bytes_are_an_error_of_ours(kept):
    from rclpy.serialization import serialize_message

    from flowbothd_perception.raw_cloud_ros import read_cloud

    with pytest.raises(InvalidCloudError, match="damaged"):
        read_cloud(serialize_message(cloud(POINTS))[:kept])


def test_what_a_cloud_may_not_be():
    message = cloud(POINTS)
    message.data = message.data[:-100]
    with pytest.raises(InvalidCloudError, match="shorter than its sizes say"):
        read(message)
    message = cloud(POINTS)
    message.fields[2].datatype = 8
    with pytest.raises(InvalidCloudError, match=r"float32 fields"):
        read(message)
    message = cloud(POINTS)
    del message.fields[0]
    with pytest.raises(InvalidCloudError, match=r"lacks fields; got y, z"):
        read(message)
    with pytest.raises(FrameUnavailableError, match=r"got rgb_camera_link; allowed: depth_camera"):
        read(cloud(POINTS, frame="rgb_camera_link"), frame_id="depth_camera_link")


@pytest.mark.parametrize("kind", ["16UC1", "32FC1", "mono16"])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("padding", [0, 8])
def test_depth_images_of_every_encoding(kind, big, padding):
    from sensor_msgs.msg import Image

    from flowbothd_perception.images_ros import from_depth_image

    item = np.dtype((">" if big else "<") + ("f4" if kind == "32FC1" else "u2"))
    values = (1000 * POINTS[..., 2]).astype(item)
    raw = b"".join(row.tobytes() + b"\xff" * padding for row in values)
    message = Image(height=6, width=8, encoding=kind, is_bigendian=int(big))
    message.step, message.data = 8 * item.itemsize + padding, array.array("B", raw)
    image = from_depth_image(message)
    assert image.dtype.isnative
    np.testing.assert_array_equal(image, values)
    message.encoding = "rgb8"
    with pytest.raises(InvalidCloudError, match=r"got rgb8; allowed: 16UC1, mono16, 32FC1"):
        from_depth_image(message)


@pytest.mark.parametrize("name", ["azure_kinect.yaml", "femto_bolt.yaml"])
def test_the_parameter_files_name_parameters_that_exist(name):
    text = (files("flowbothd_perception") / "config" / name).read_text()
    values = yaml.safe_load(text)["/**/perception_node"]["ros__parameters"]
    flat = {k: v for k, v in values.items() if k != "camera"}
    flat |= {f"camera.{k}": v for k, v in values["camera"].items()}
    params = build(PerceptionNodeParams, flat)
    assert params.camera.frame
    assert set(flat) <= {spec.name for spec in specifications(PerceptionNodeParams)}
