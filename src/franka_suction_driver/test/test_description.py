"""The composed URDF: one file that Pinocchio and PyBullet both read, with the tool where it is."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio
import pybullet
import pytest

from franka_suction_driver.arm.description import (
    DescriptionError,
    ToolDimensions,
    compose_urdf,
    find_arm_urdf,
)

START = np.array([0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4])


@pytest.fixture(scope="module")
def urdf() -> str:
    return compose_urdf()


def test_seven_joints_no_hand_and_absolute_meshes(urdf: str) -> None:
    root = ET.fromstring(urdf)
    movable = [j.get("name") for j in root.findall("joint") if j.get("type") != "fixed"]
    assert movable == [f"panda_joint{i}" for i in range(1, 8)]
    names = {link.get("name") for link in root.findall("link")}
    assert not {n for n in names if n and ("hand" in n or "finger" in n)}
    assert {
        "panda_link0",
        "panda_link8",
        "suction_body",
        "suction_stem",
        "suction_cup",
        "suction_tip",
    } <= names
    meshes = [Path(m.get("filename", "")) for m in root.iter("mesh")]
    assert meshes and all(m.is_absolute() and m.is_file() for m in meshes)


def test_tip_lies_where_the_tool_says(urdf: str) -> None:
    model = pinocchio.buildModelFromXML(urdf)
    data = model.createData()
    assert model.nq == 7
    pinocchio.framesForwardKinematics(model, data, START)
    flange = data.oMf[model.getFrameId("panda_link8")]
    tip = data.oMf[model.getFrameId("suction_tip")]
    relative = flange.actInv(tip)
    np.testing.assert_allclose(relative.translation, [0, 0, 0.16], atol=1e-12)
    np.testing.assert_allclose(relative.rotation, np.eye(3), atol=1e-12)


def test_pybullet_agrees_with_pinocchio(urdf: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(urdf)
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.loadURDF(
            str(path),
            useFixedBase=True,
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=client,
        )
        count = pybullet.getNumJoints(body, physicsClientId=client)
        infos = [pybullet.getJointInfo(body, i, physicsClientId=client) for i in range(count)]
        links = {info[12].decode(): info[0] for info in infos}
        arm = [info[0] for info in infos if info[2] == pybullet.JOINT_REVOLUTE]
        assert len(arm) == 7
        for joint, value in zip(arm, START, strict=True):
            pybullet.resetJointState(body, joint, value, physicsClientId=client)
        state = pybullet.getLinkState(
            body, links["suction_tip"], computeForwardKinematics=True, physicsClientId=client
        )
        tip = np.array(state[4])
    finally:
        pybullet.disconnect(client)
    model = pinocchio.buildModelFromXML(urdf)
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, START)
    expected = data.oMf[model.getFrameId("suction_tip")].translation
    np.testing.assert_allclose(tip, expected, atol=1e-6)


def test_another_tool_moves_the_tip() -> None:
    model = pinocchio.buildModelFromXML(compose_urdf(ToolDimensions(tip=0.2), tip_frame="lip"))
    placement = model.frames[model.getFrameId("lip")].placement
    assert placement.translation[2] == pytest.approx(0.107 + 0.2)


def test_impossible_tool_is_named() -> None:
    with pytest.raises(DescriptionError, match=r"no room for its stem.*less than the tip"):
        ToolDimensions(tip=0.08)
    with pytest.raises(DescriptionError, match=r"cup_mass.*got -1"):
        ToolDimensions(cup_mass=-1.0)


def test_missing_arm_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("franka_suction_driver.arm.description.ARM_DISTRIBUTION", "no-such-package")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    with pytest.raises(DescriptionError, match="make setup"):
        find_arm_urdf()


def test_missing_mesh_is_named(tmp_path: Path) -> None:
    text = find_arm_urdf().read_text()
    folder = tmp_path / "robots" / "panda_description" / "urdf"
    folder.mkdir(parents=True)
    (folder / "panda.urdf").write_text(text)
    with pytest.raises(DescriptionError, match=r"mesh.*link0\.dae"):
        compose_urdf(arm_urdf=folder / "panda.urdf")
