"""Calibration: poses that are known come out again, and what cannot work is said."""

import numpy as np
import pytest

from flowbothd_common.errors import InvalidCloudError, ParameterError
from flowbothd_common.transforms import (
    apply,
    inverse,
    look_at,
    rotation_about,
    transform,
)
from flowbothd_perception.calibration import captures as files
from flowbothd_perception.calibration.board import Board, find_board
from flowbothd_perception.calibration.captures import Capture
from flowbothd_perception.calibration.hand_eye import rigid_between, solve_hand_eye
from flowbothd_perception.calibration.methods import by_tool, check
from flowbothd_perception.calibration.pose import difference, twisted
from flowbothd_perception.depth import Lens, distort

CAMERA = look_at((0.5, -1.1, 0.7), (0.45, 0, 0.3))
BOARD = Board(9, 6, 0.025)
LENS = Lens(320, 288, (252.0, 0, 159.5, 0, 252.0, 143.5, 0, 0, 1))
KINECT = Lens(
    320,
    288,
    (252.0, 0, 159.5, 0, 252.0, 143.5, 0, 0, 1),
    (2.95, 1.62, -1.1e-4, 3.4e-5, 0.083, 3.28, 2.44, 0.43),
)


def random_pose(rng, spread=1.0):
    return transform(
        rotation_about(rng.normal(size=3), rng.uniform(0.2, spread)), rng.normal(size=3)
    )


def hand_eye_problem(rng, poses=8, noise=0.0, turns=None):
    on_tool = random_pose(rng, 2.0)
    tips, boards = [], []
    for k in range(poses):
        axis = rng.normal(size=3) if turns is None else turns
        tip = transform(rotation_about(axis, 0.3 + 0.2 * k), rng.uniform(-0.3, 0.3, 3))
        tips.append(tip)
        seen = apply(inverse(CAMERA) @ tip @ on_tool, BOARD.corners)
        boards.append(seen + noise * rng.normal(size=seen.shape))
    return tips, boards, on_tool


@pytest.mark.parametrize("seed", range(5))
def test_camera_and_board_are_found_exactly_without_noise(seed):
    tips, boards, on_tool = hand_eye_problem(np.random.default_rng(seed))
    calibration, board = solve_hand_eye(tips, boards, BOARD.corners)
    np.testing.assert_allclose(calibration.T_base_camera, CAMERA, atol=1e-6)
    np.testing.assert_allclose(board, on_tool, atol=1e-6)
    assert calibration.residual < 1e-6


def test_noise_shows_in_the_residual_and_hardly_in_the_pose():
    tips, boards, _ = hand_eye_problem(np.random.default_rng(0), poses=7, noise=0.001)
    calibration, _ = solve_hand_eye(tips, boards, BOARD.corners)
    distance, angle = difference(calibration.T_base_camera, CAMERA)
    assert 0.001 < calibration.residual < 0.003
    assert distance < 0.005
    assert angle < 0.006
    assert calibration.spread > distance / 10


def test_turning_about_one_axis_is_not_enough_and_that_is_said():
    rng = np.random.default_rng(0)
    tips, boards, _ = hand_eye_problem(rng, turns=np.array([0.0, 0.0, 1.0]))
    with pytest.raises(InvalidCloudError, match=r"one axis only.*different directions"):
        solve_hand_eye(tips, boards, BOARD.corners)
    with pytest.raises(InvalidCloudError, match=r"too few arm poses with a board; got 2"):
        solve_hand_eye(tips[:2], boards[:2], BOARD.corners)


def test_rigid_between_is_the_transform_even_for_flat_points():
    pose = random_pose(np.random.default_rng(3), 3.0)
    found = rigid_between(BOARD.corners, apply(pose, BOARD.corners))
    np.testing.assert_allclose(found, pose, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_twist_turns_about_its_pivot(seed):
    rng = np.random.default_rng(seed)
    change, pivot = rng.normal(size=6), rng.normal(size=3)
    matrix = twisted(change, pivot)
    np.testing.assert_allclose(apply(matrix, pivot), pivot + change[:3])
    assert np.isclose(np.linalg.det(matrix[:3, :3]), 1.0)


def picture_of_board(lens, pose):
    """Picture of an infrared camera: squares, a white margin, nothing else."""
    v, u = np.mgrid[0 : lens.height : 0.5, 0 : lens.width : 0.5] - 0.25
    fx, _, cx, _, fy, cy = lens.matrix[:6]
    rays = np.stack([(u - cx) / fx, (v - cy) / fy], axis=-1)
    seen = rays.copy()
    for _ in range(12 if lens.distortion else 0):
        rays += seen - distort(rays, lens.distortion)
    directions = np.dstack([rays, np.ones(rays.shape[:2])])
    normal, origin = pose[:3, 2], pose[:3, 3]
    hit = directions * ((normal @ origin) / (directions @ normal))[..., None]
    x, y = np.moveaxis(((hit - origin) @ pose[:3, :2]) / BOARD.square, -1, 0)
    on_board = (x > -2) & (x < BOARD.columns + 1) & (y > -2) & (y < BOARD.rows + 1)
    squares = (x > -1) & (x < BOARD.columns) & (y > -1) & (y < BOARD.rows)
    dark = squares & ((np.floor(x) + np.floor(y)) % 2 == 0)
    values = np.where(on_board, np.where(dark, 30.0, 220.0), 90.0)
    small = values.reshape(lens.height, 2, lens.width, 2).mean(axis=(1, 3))
    return small.astype(np.uint8)


def test_a_board_is_found_through_a_distorting_lens():
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    pose = transform(
        rotation_about((1, 0, 0), 0.4) @ rotation_about((0, 1, 0), -0.3), (-0.09, -0.05, 0.45)
    )
    corners = find_board(picture_of_board(KINECT, pose), KINECT, BOARD)
    assert corners is not None
    truth = apply(pose, BOARD.corners)
    # A board may be numbered from the other end; as a set its corners are the same.
    flipped = corners[::-1]
    error = min(np.abs(corners - truth).max(), np.abs(flipped - truth).max())
    assert error < 0.003
    assert find_board(np.full((288, 320), 90, np.uint8), KINECT, BOARD) is None


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Board(9, 7, 0.025), "same when turned by half"),
        (lambda: Board(2, 5, 0.025), "at least 3 x 3"),
        (lambda: Board(9, 6, 25.0), "25.0 m; allowed: 0.002 to 0.5 m"),
    ],
)
def test_boards_that_cannot_work_are_refused(make, message):
    with pytest.raises(ParameterError, match=message):
        make()


def test_captures_survive_the_disk(tmp_path):
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4)
    lens = Lens(4, 3, (2.0, 0, 1.5, 0, 2.0, 1.0, 0, 0, 1), (0.1,) * 8)
    taken = [
        Capture(("a", "b"), np.array([0.5, -0.25]), lens, depth),
        Capture(("a", "b"), np.zeros(2), lens, depth, np.ones((3, 4), np.uint8)),
    ]
    files.save(tmp_path, taken)
    back = files.load(tmp_path)
    assert [c.joint_names for c in back] == [("a", "b")] * 2
    assert back[0].lens == lens
    assert back[0].picture is None
    np.testing.assert_array_equal(back[1].picture, taken[1].picture)
    np.testing.assert_array_equal(back[0].depth, depth)
    np.testing.assert_array_equal(back[0].joint_positions, taken[0].joint_positions)
    with pytest.raises(InvalidCloudError, match=r"no captures.*capture_"):
        files.load(tmp_path / "elsewhere")
    (tmp_path / "capture_09.npz").write_bytes(b"nothing")
    with pytest.raises(InvalidCloudError, match=r"capture_09.npz is no capture"):
        files.load(tmp_path)


TOOL = ("pole", "ball")
ROBOT = (
    '<robot name="toy"><link name="base"/>'
    '<link name="arm"/><link name="pole"><collision><origin xyz="0.15 0 0" rpy="0 1.5708 0"/>'
    '<geometry><cylinder radius="0.04" length="0.3"/></geometry></collision></link>'
    '<link name="ball"><collision><origin xyz="0.3 0 0.08"/><geometry><sphere radius="0.06"/>'
    "</geometry></collision></link>"
    '<joint name="yaw" type="revolute"><parent link="base"/><child link="arm"/>'
    '<origin xyz="0.3 0 0.35"/><axis xyz="0 0 1"/>'
    '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    '<joint name="pitch" type="revolute"><parent link="arm"/><child link="pole"/>'
    '<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    '<joint name="fixed" type="fixed"><parent link="pole"/><child link="ball"/></joint></robot>'
)


def cast(shape_points, q):
    """Depth image of a cloud of surface points, nearest wins; a wall behind."""
    seen = apply(inverse(CAMERA), shape_points)
    fx, _, cx, _, fy, cy = LENS.matrix[:6]
    depth = np.full((LENS.height, LENS.width), 2000, np.uint16)
    u = np.rint(seen[:, 0] / seen[:, 2] * fx + cx).astype(int)
    v = np.rint(seen[:, 1] / seen[:, 2] * fy + cy).astype(int)
    near_first = np.argsort(-seen[:, 2])
    inside = (u >= 0) & (v >= 0) & (u < LENS.width) & (v < LENS.height)
    order = near_first[inside[near_first]]
    depth[v[order], u[order]] = np.rint(1000 * seen[order, 2])
    return Capture(("yaw", "pitch"), np.array(q), LENS, depth)


def toy_captures(count=6):
    rng = np.random.default_rng(0)
    turn = rng.uniform(0, 2 * np.pi, 60000)
    pole = np.stack([rng.uniform(0, 0.3, 60000), 0.04 * np.cos(turn), 0.04 * np.sin(turn)], axis=1)
    ball = rng.normal(size=(40000, 3))
    ball = 0.06 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + (0.3, 0, 0.08)
    shape, result = np.concatenate([pole, ball]), []
    for k in range(count):
        q = (-1.2 + 0.5 * k, 0.5 * np.sin(1.7 * k))
        pose = transform(rotation_about((0, 0, 1), q[0]), (0.3, 0, 0.35)) @ transform(
            rotation_about((0, 1, 0), q[1])
        )
        result.append(cast(apply(pose, shape), q))
    return result


@pytest.mark.long
def test_the_tool_alone_tells_where_the_camera_is():
    captures = toy_captures()
    guess = CAMERA @ transform(rotation_about((1, 1, 0), 0.05), (0.015, -0.02, 0.02))
    calibration = by_tool(ROBOT, TOOL, captures, guess)
    distance, angle = difference(calibration.T_base_camera, CAMERA)
    assert distance < 0.006
    assert np.degrees(angle) < 0.4
    assert calibration.residual < 0.004
    wrong = CAMERA @ transform(translation=(0.02, 0.0, 0.0))
    looked = check(ROBOT, TOOL, captures, wrong)
    assert 0.012 < looked.at_tool < 0.028
    assert looked.verdict.startswith("bad")


def test_what_cannot_be_calibrated_is_said():
    captures = toy_captures(2)
    with pytest.raises(InvalidCloudError, match="at least 3"):
        by_tool(ROBOT, TOOL, captures, CAMERA)
    with pytest.raises(ParameterError, match=r"\['elbow'\]; allowed: pole, ball"):
        by_tool(ROBOT, ("elbow",), captures, CAMERA)
