"""The parameters that motion_node and arm_node start with, and what their logs say of them."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from flowbothd_common.parameters import build
from franka_suction_driver.arm.limits_text import arm_limits, motion_limits
from franka_suction_driver.backend_params import ArmNodeParams
from franka_suction_driver.params import MotionNodeParams, MotionParams

DOMAIN = 78
LIMITS = "{ros__parameters: {safety: {dry_run: true, force_limit: 30.0}}}"


def test_the_log_of_motion_node_says_the_limits_that_hold():
    """The incident: the log of a node that had dropped a lab's file looked like any other."""
    plain = motion_limits(MotionParams())
    assert "dry_run off" in plain and "force limit 40 N" in plain
    assert "workspace [-0.2, -0.8, 0] .. [1, 0.8, 1.1] m" in plain
    assert "speed scale 0.1" in plain and "table at 0 m" in plain
    given = {
        "safety.dry_run": True,
        "safety.force_limit": 30.0,
        "safety.workspace_min": (0.1, -0.5, 0.01),
        "safety.speed_scale": 0.25,
        "collision.table_height": -0.12,
    }
    text = motion_limits(build(MotionParams, given))
    for said in ("dry_run on", "30 N", "[0.1, -0.5, 0.01] ..", "scale 0.25", "table at -0.12 m"):
        assert said in text
    assert "\n" not in text


def test_the_log_of_arm_node_says_backend_thresholds_and_where_joint_limits_come_from():
    plain = arm_limits(ArmNodeParams())
    assert "backend panda" in plain and "force limit 45 N" in plain
    assert "70 N, [50, 50, 50, 50, 12, 12, 12] Nm" in plain
    assert "joint limits of the composed description" in plain
    topic = arm_limits(build(ArmNodeParams, {"backend": "topic"}))
    assert "the controller's" in topic and " N" not in topic
    seven = (1.0,) * 7
    some = {"robot.velocity_limits": seven, "robot.description_file": "/lab/tool.urdf"}
    assert arm_limits(build(ArmNodeParams, some)).endswith(
        "joint limits of robot.velocity_limits and /lab/tool.urdf"
    )
    all_three = some | {"robot.lower_limits": seven, "robot.upper_limits": seven}
    assert arm_limits(build(ArmNodeParams, all_three)).endswith("robot.velocity_limits")


class Process:
    """A node as a process; keeps the lines of its log."""

    def __init__(self, node: str, *arguments: str) -> None:
        self.lines: list[str] = []
        self._process = subprocess.Popen(
            [sys.executable, "-m", f"franka_suction_driver.{node}", "--ros-args", *arguments],
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stderr is not None
        self.lines.extend(self._process.stderr)

    def wait(self) -> int:
        code = self._process.wait(timeout=60)
        self._reader.join(timeout=10)
        return code

    def close(self) -> None:
        self._process.terminate()
        try:
            self.wait()
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(timeout=10)


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Starts a node with a file of one entry under a namespace; none outlives the test."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    started: list[Process] = []

    def begin(node: str, entry: str, namespace: str, values: str = LIMITS) -> Process:
        file = tmp_path / "lab.yaml"
        file.write_text(f"{entry}: {values}\n")
        remap = ("-r", f"__ns:={namespace}") if namespace else ()
        started.append(Process(node, *remap, "--params-file", str(file)))
        return started[-1]

    yield begin
    for process in started:
        process.close()


@pytest.mark.ros
@pytest.mark.parametrize("namespace", ["", "/left"])
def test_a_labs_dry_run_holds_in_the_root_and_under_a_namespace(
    ros: Any, start: Any, namespace: str
):
    """The incident: under a namespace the lab's file was dropped; dry_run off, 40 N not 30."""
    from rcl_interfaces.srv import GetParameters
    from rclpy.node import Node

    process = start("motion_node", "/**/motion_node", namespace)
    user = ros.add(Node, "user")
    client = user.create_client(GetParameters, f"{namespace}/motion_node/get_parameters")
    names = ["safety.dry_run", "safety.force_limit"]
    dry, force = ros.ask(client, GetParameters.Request(names=names)).values
    assert dry.bool_value and force.double_value == 30.0
    ros.until(lambda: any("limits:" in line for line in process.lines), "the line of the log")
    said = next(line for line in process.lines if "limits:" in line)
    assert "[INFO]" in said and "dry_run on" in said and "force limit 30 N" in said


@pytest.mark.ros
@pytest.mark.parametrize("node", ["motion_node", "arm_node"])
@pytest.mark.parametrize(
    ("written", "namespace"), [("{}", "/left"), ("misspelt_{}", ""), ("/right/{}", "/left")]
)
def test_a_node_that_moves_an_arm_does_not_run_on_a_file_that_misses_it(
    start: Any, node: str, written: str, namespace: str
):
    """The incident: `motion_node:` under /left was dropped without a word, and the arm moved."""
    process = start(node, written.format(node), namespace, "{ros__parameters: {}}")
    assert process.wait() == 2
    (error,) = [line for line in process.lines if "[ERROR]" in line]
    assert f"lab.yaml has no parameters for {namespace}/{node}" in error
    assert written.format(node) in error and f"write /**/{node}" in error


@pytest.mark.ros
@pytest.mark.parametrize(
    ("value", "said"),
    [
        (".nan", "safety.force_limit is not finite; got nan"),
        (".inf", "safety.force_limit is not finite; got inf"),
        ("30", "got 30; allowed: double 1 <= x; a double needs a decimal point"),
        ("'30'", "safety.force_limit has the wrong type; got '30'"),
        ("0.5", "safety.force_limit is out of range; got 0.5; allowed: 1 <= x"),
    ],
)
def test_a_number_that_cannot_be_a_limit_is_refused_by_name(start: Any, value: str, said: str):
    """The incident: `nan > limit` is false, so that a NaN limit stops nothing."""
    values = f"{{ros__parameters: {{safety: {{force_limit: {value}}}}}}}"
    process = start("motion_node", "/**/motion_node", "", values)
    assert process.wait() == 2
    assert said in process.lines[-1]


@pytest.mark.ros
@pytest.mark.parametrize(
    "values", [{"camera_position": [0.5, float("nan"), 0.6]}, {"input_timeout": float("nan")}]
)
def test_nan_is_refused_with_and_without_a_range(ros: Any, values: dict[str, Any]):
    """ROS compares with a range only where there is one, and only single numbers."""
    from flowbothd_common.errors import ParameterError
    from franka_suction_driver.motion_node import MotionNode

    with pytest.raises(ParameterError, match=f"{next(iter(values))} is not finite"):
        ros.add(MotionNode, **values)


@pytest.mark.ros
def test_a_limit_cannot_be_set_to_nan_while_the_node_runs(ros: Any):
    from rcl_interfaces.srv import SetParameters
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    from franka_suction_driver.motion_node import MotionNode

    node = ros.add(MotionNode)
    user = ros.add(Node, "user")
    client = user.create_client(SetParameters, "/motion_node/set_parameters")
    values = {"safety.force_limit": float("nan"), "camera_position": [float("nan"), 0.0, 0.0]}
    wanted = [Parameter(name, value=v).to_parameter_msg() for name, v in values.items()]
    answers = ros.ask(client, SetParameters.Request(parameters=wanted)).results
    assert [answer.successful for answer in answers] == [False, False]
    assert all(answer.reason for answer in answers)
    assert node.get_parameter("safety.force_limit").value == MotionNodeParams().safety.force_limit
