"""The command line: help, versions, bad input; scenes and parameters behind it."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from flowbothd.cli import COMMANDS, NOT_TRIED, main
from flowbothd_common.errors import ObjectModelError
from sim_bridge.scenes import load_scenes, scene_for


def help_of(capsys, *words: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main([*words, "--help"])
    assert ended.value.code == 0
    return capsys.readouterr().out


@pytest.mark.ros
@pytest.mark.parametrize("command", COMMANDS, ids=lambda c: c.name)
def test_every_command_has_help_with_examples(capsys, command):
    text = help_of(capsys, *command.name.split())
    assert "examples:" in text
    assert all(example in text for example in command.examples)


def test_help_is_immediate():
    """The incident this guards against: --help that imports torch, Open3D and PyBullet first."""
    code = "import sys; from flowbothd.cli import main\n"
    code += "try:\n main(['--help'])\nexcept SystemExit: pass\n"
    code += "sys.exit(any(m in sys.modules for m in ('torch', 'open3d', 'pybullet', 'rclpy')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert done.returncode == 0


def test_version_names_what_matters(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    text = capsys.readouterr().out
    assert text.startswith("flowbothd ") and "numpy" in text and "Python" in text


@pytest.mark.ros
@pytest.mark.parametrize("command", [c for c in COMMANDS if c.for_robot], ids=lambda c: c.name)
def test_commands_for_a_robot_say_once_that_none_has_been_tried(capsys, monkeypatch, command):
    """The text of these commands read as if a lab had run them."""
    module = importlib.import_module(command.module)
    monkeypatch.setattr(module, "run", lambda _: 0)
    needed = ["check", "--captures", "nowhere"] if command.name == "calibrate" else []
    assert main([*command.name.split(), *needed]) == 0
    assert capsys.readouterr().out == f"{NOT_TRIED}\n"
    assert NOT_TRIED in " ".join(help_of(capsys, *command.name.split()).split())


def test_the_commands_for_a_robot_are_these():
    assert {c.name for c in COMMANDS if c.for_robot} == {"up robot", "doctor", "calibrate"}
    assert NOT_TRIED.startswith("not yet tried on hardware")


@pytest.mark.ros
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["demo", "--object", "wardrobe"], "custom_door"),
        (["up", "sim", "--mode", "sideways"], "pull_left"),
        (["up", "sim", "--domain", "1000"], "0..101"),
        (["trials", "--suite", "partnet"], "--objects"),
    ],
)
def test_bad_input_is_told_on_one_line(capsys, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    told = capsys.readouterr().err
    assert told.startswith("flowbothd: ") and said in told and told.count("\n") == 1


def test_scenes_are_complete_and_a_file_gets_the_default_one(tmp_path):
    scenes = load_scenes()
    assert {"custom_door", "drawer", "cabinet_door", "lidded_box", "default"} <= set(scenes)
    file = tmp_path / "thing.urdf"
    file.write_text("<robot/>")
    assert scene_for(str(file)).object == str(file)
    with pytest.raises(ObjectModelError, match="drawer"):
        scene_for("drawr")


@pytest.mark.ros
def test_one_pose_serves_all_modes_of_the_ambiguous_door():
    """Otherwise the pose would tell the mode."""
    from flowbothd_bringup.sim_graph import RunOptions, sim_parameters

    scene = scene_for("custom_door")
    poses = {
        tuple(sim_parameters(scene, RunOptions(mode=mode))["bridge_node"]["object_position"])
        for mode in ("pull_left", "pull_right", "push_left", "push_right")
    }
    assert len(poses) == 1


@pytest.mark.ros
def test_camera_and_perception_get_the_same_calibration_and_overrides_win(tmp_path: Path):
    from flowbothd_bringup.sim_graph import RunOptions, sim_parameters
    from flowbothd_common.parameter_files import read_parameters, write_parameters

    options = RunOptions(seed=7, overrides={"policy_node": {"max_steps": 3}})
    parameters = sim_parameters(scene_for("drawer"), options)
    for name in ("camera.position", "camera.quaternion"):
        assert parameters["bridge_node"][name] == parameters["perception_node"][name]
    assert parameters["policy_node"]["max_steps"] == 3
    assert parameters["policy_node"]["seed"] == 7
    file = tmp_path / "parameters.yaml"
    write_parameters(file, parameters)
    assert read_parameters(file) == parameters
    # The incident: camera.position was written once and referred to, which ROS refuses.
    assert "*id" not in file.read_text()
    assert "ros__parameters" in yaml.safe_load(file.read_text())["/**/bridge_node"]
