"""The launch files start the graph that the command line starts, with the same parameters.

`launch` exists with ROS from apt alone, so that the little of it that the files use stands in here:
declarations with defaults, an opaque function that is called with the context, node actions.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import types
from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

FOLDER = Path(__file__).resolve().parent.parent / "launch"
NEVER_NEEDED = ("honcho", "torch", "matplotlib", "rerun")
"""What no launch file may import; a module that is None in sys.modules cannot be imported."""


class Declared:
    def __init__(self, name, *, default_value, description):
        assert description, f"launch argument {name} has no description"
        self.name, self.default = name, default_value


class Opaque:
    def __init__(self, *, function):
        self.function = function


class Environment:
    def __init__(self, name, value):
        self.name, self.value = name, value


class Configuration:
    """Its value is looked up when the launch runs, not when the file is read."""

    def __init__(self, name, *, default=None):
        self.name, self.default = name, default

    def perform(self, context):
        return context[self.name] if self.default is None else context.get(self.name, self.default)


class Node:
    def __init__(self, *, package, executable, name, namespace, output, parameters, remappings):
        self.package, self.executable, self.name = package, executable, name
        self.parameters, self.namespace, self.remappings = parameters, namespace, remappings


@pytest.fixture
def launch(monkeypatch):
    """Runs a launch file with arguments; gives its actions."""
    modules = {
        "launch": types.SimpleNamespace(LaunchDescription=list),
        "launch.actions": types.SimpleNamespace(
            DeclareLaunchArgument=Declared,
            OpaqueFunction=Opaque,
            SetEnvironmentVariable=Environment,
        ),
        "launch.substitutions": types.SimpleNamespace(LaunchConfiguration=Configuration),
        "launch_ros": types.SimpleNamespace(),
        "launch_ros.actions": types.SimpleNamespace(Node=Node),
    }
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "flowbothd_bringup.launching", raising=False)

    def run(file, *, below="", **arguments):
        spec = importlib.util.spec_from_file_location("launch_file", FOLDER / file)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        described = module.generate_launch_description()
        context = {a.name: a.default for a in described if isinstance(a, Declared)}
        assert set(arguments) <= set(context), "an argument that the file does not declare"
        # PushRosNamespace keeps the namespace among the launch configurations.
        pushed = {"ros_namespace": below} if below else {}
        return described[-1].function(context | arguments | pushed)

    yield run
    sys.modules.pop("flowbothd_bringup.launching", None)


def started(actions):
    return {a.name: a for a in actions if isinstance(a, Node)}


def parameters_of(actions):
    files = {file for node in started(actions).values() for file in node.parameters}
    assert len(files) == 1
    return yaml.safe_load(Path(files.pop()).read_text())


def plain(parameters):
    return {f"/**/{node}": {"ros__parameters": values} for node, values in parameters.items()}


def test_simulation(launch):
    from flowbothd_bringup.sim_graph import RunOptions, sim_nodes, sim_parameters
    from sim_bridge.scenes import scene_for

    actions = launch("sim.launch.py", object="drawer", seed="3", start="true", predictor="oracle")
    nodes, wanted = started(actions), sim_nodes("oracle")
    assert set(nodes) == set(wanted)
    assert {n.package for n in nodes.values()} == {m.split(".")[0] for m in wanted.values()}
    options = RunOptions(seed=3, predictor="oracle", start=True)
    assert parameters_of(actions) == plain(sim_parameters(scene_for("drawer"), options))
    profiles = [a for a in actions if isinstance(a, Environment)]
    assert "FASTRTPS_DEFAULT_PROFILES_FILE" in {a.name for a in profiles}, "clouds would be dropped"


def test_every_graph_can_be_recorded(launch):
    actions = launch("sim.launch.py", record="bags/one", profile="all")
    assert started(actions)["recorder_node"].package == "flowbothd_rosbag"
    values = parameters_of(actions)["/**/recorder_node"]["ros__parameters"]
    assert values == {"out": "bags/one", "profile": "all"}


def test_robot(launch, tmp_path):
    from flowbothd_bringup.robot_graph import NODES, RobotOptions, robot_parameters
    from flowbothd_common.errors import ParameterError

    with pytest.raises(ParameterError):
        launch("robot.launch.py", backend="mock")
    lab = tmp_path / "lab.yaml"
    lab.write_text(
        "perception_node: {ros__parameters: {camera.position: [1.0, 0.0, 1.0], "
        "camera.quaternion: [0.0, 0.0, 0.0, 1.0]}}\n"
    )
    actions = launch("robot.launch.py", backend="mock", params=str(lab), speed="0.2")
    assert set(started(actions)) == set(NODES)
    options = RobotOptions(backend="mock", files=(lab,), speed=0.2)
    assert parameters_of(actions) == plain(robot_parameters(options))


def test_below_a_namespace_the_files_of_a_lab_apply(launch, tmp_path):
    """The incident: below PushRosNamespace a lab's dry_run was dropped without a word."""
    from flowbothd_common.errors import ParameterError

    lab = tmp_path / "lab.yaml"
    camera = (
        "perception_node: {ros__parameters: {camera.position: [1.0, 0.0, 1.0], "
        "camera.quaternion: [0.0, 0.0, 0.0, 1.0]}}\n"
    )
    arguments = {"params": str(lab), "backend": "mock"}
    for name in ("motion_node", "/left/motion_node"):
        lab.write_text(camera + f"{name}: {{ros__parameters: {{safety.dry_run: true}}}}\n")
        values = parameters_of(launch("robot.launch.py", below="/left", **arguments))
        assert values["/**/motion_node"]["ros__parameters"]["safety.dry_run"] is True
    with pytest.raises(ParameterError, match="/left/motion_node reach no node"):
        launch("robot.launch.py", below="/right", **arguments)


def test_replay(launch, tmp_path):
    from flowbothd_rosbag.metadata import BagError, Topic
    from flowbothd_rosbag.writer import BagWriter

    writer = BagWriter(tmp_path / "bag")
    writer.add_topic(Topic("/joint_states", "sensor_msgs/msg/JointState"))
    writer.attach(
        "parameters.yaml",
        "application/yaml",
        b"perception_node: {ros__parameters: {seed: 7, use_sim_time: false}}\n",
    )
    writer.close()
    bag = str(tmp_path / "bag")
    actions = launch("replay.launch.py", bag=bag, rate="2.0", perception="true")
    assert set(started(actions)) == {"player_node", "perception_node"}
    values = parameters_of(actions)
    assert values["/**/perception_node"]["ros__parameters"] == {"seed": 7, "use_sim_time": True}
    player = values["/**/player_node"]["ros__parameters"]
    assert player["rate"] == 2.0 and "object_cloud" in player["exclude"]
    assert player["wait_for"] == ["/joint_states"]
    with pytest.raises(BagError, match="> 0"):
        launch("replay.launch.py", bag=bag, rate="0")


def test_launch_files_need_no_process_manager():
    """The incident: `ros2 launch` failed without honcho, which only the command line needs."""
    names = ("launch", "launch.actions", "launch.substitutions", "launch_ros", "launch_ros.actions")
    code = f"""
import sys, types, importlib.util
class Anything(types.ModuleType):
    def __getattr__(self, name):
        return object
sys.modules.update({{name: Anything(name) for name in {names!r}}})
sys.modules.update(dict.fromkeys({NEVER_NEEDED!r}))
for file in sys.argv[1:]:
    spec = importlib.util.spec_from_file_location("launch_file", file)
    spec.loader.exec_module(importlib.util.module_from_spec(spec))
"""
    files = sorted(str(file) for file in FOLDER.glob("*.launch.py"))
    run = subprocess.run(
        [sys.executable, "-c", code, *files],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert files and run.returncode == 0, run.stderr
