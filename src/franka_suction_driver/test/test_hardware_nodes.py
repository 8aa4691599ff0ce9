"""arm_node and pump_node in process, over the mock backend and over a controller's topics."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

DOMAIN = 74


def make_user() -> Any:
    """Whoever beats, commands and listens beside the hardware nodes."""
    from geometry_msgs.msg import WrenchStamped
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Header
    from std_srvs.srv import Trigger
    from trajectory_msgs.msg import JointTrajectory

    from flowbothd_common.ros import qos
    from flowbothd_interfaces.msg import Heartbeat

    class User(Node):
        def __init__(self, **kwargs: Any) -> None:
            super().__init__("user", **kwargs)
            self.beating = True
            self.joints: list[Any] = []
            self.wrenches: list[Any] = []
            self.said: dict[str, tuple[bool, str]] = {}
            self.passed_on: list[Any] = []
            beat = self.create_publisher(Header, "motion/heartbeat", qos.HEARTBEAT)
            self.create_timer(0.02, lambda: self.beating and beat.publish(Header()))
            self.trajectory = self.create_publisher(
                JointTrajectory, "joint_trajectory", qos.COMMAND
            )
            self.robot = self.create_publisher(JointState, "joint_states", qos.STATE)
            self.create_subscription(JointState, "joint_states", self.joints.append, qos.STATE)
            self.create_subscription(
                WrenchStamped, "external_wrench", self.wrenches.append, qos.SENSOR
            )
            self.create_subscription(
                JointTrajectory, "controller/joint_trajectory", self.passed_on.append, qos.COMMAND
            )
            self.create_subscription(Heartbeat, "heartbeat", self._on_heartbeat, qos.HEARTBEAT)
            self.recover = self.create_client(Trigger, "arm/recover")
            self.tare = self.create_client(Trigger, "arm/tare")

        def _on_heartbeat(self, message: Any) -> None:
            self.said[message.node] = (message.ready, message.detail)

        def position(self) -> np.ndarray:
            return np.array(self.joints[-1].position)

    return User


def trajectory(start: np.ndarray, by: float, limits: Any, names: Any) -> Any:
    from flowbothd_common.motion import JointState
    from flowbothd_common.ros.conversions import to_trajectory
    from franka_suction_driver.arm.trajectory import joint_move

    return to_trajectory(joint_move(names, JointState.at_rest(start), start + by, limits))


@pytest.fixture
def bench(ros: Any) -> Any:
    """arm_node over the mock robot, with somebody who beats."""
    from franka_suction_driver.arm_node import ArmNode

    user = ros.add(make_user())
    node = ros.add(ArmNode, backend="mock", heartbeat_timeout=0.3)
    ros.until(lambda: bool(user.joints) and bool(user.wrenches), "joint states and wrench")
    ros.until(lambda: not node._holding, "the heartbeat")
    ros.until(lambda: user.trajectory.get_subscription_count() > 0, "the trajectory's reader")
    return user, node, node._backend._library.robot


def test_a_trajectory_moves_the_robot_and_silence_holds_it(
    ros: Any, bench: Any, limits: Any
) -> None:
    user, node, robot = bench
    names = node._names
    user.trajectory.publish(trajectory(user.position(), 0.05, limits, names))
    goal = user.position() + 0.05
    ros.until(lambda: np.allclose(user.position(), goal, atol=1e-3), "the motion")
    user.trajectory.publish(trajectory(robot.q.copy(), -0.6, limits, names))
    ros.until(lambda: bool(np.abs(robot.dq).max() > 0.2), "the second motion")
    user.beating = False
    ros.until(lambda: node._holding and not robot.dq.any(), "the stop", seconds=3.0)
    assert np.abs(robot.q - goal).max() < 0.5
    user.trajectory.publish(trajectory(robot.q.copy(), 0.05, limits, names))
    ros.until(lambda: "silent" in node._refused, "the refusal")


def test_a_reflex_is_told_and_only_cleared_on_request(ros: Any, bench: Any, limits: Any) -> None:
    from std_srvs.srv import Trigger

    user, node, robot = bench
    robot.reflex("cartesian_reflex")
    ros.until(lambda: "cartesian_reflex" in user.said.get("arm_node", (True, ""))[1], "the fault")
    assert user.said["arm_node"][0] is False
    user.trajectory.publish(trajectory(robot.q.copy(), 0.05, limits, node._names))
    ros.until(lambda: "cartesian_reflex" in node._refused, "the refusal")
    assert "automatic_error_recovery" not in robot.names()
    assert ros.ask(user.recover, Trigger.Request()).success
    ros.until(lambda: user.said["arm_node"][0], "health")


def test_a_wrench_that_is_not_known_is_not_published(ros: Any, bench: Any) -> None:
    """The trap: zeros near a singularity must reach nobody as a measurement."""
    from std_srvs.srv import Trigger

    user, _, robot = bench
    robot.wrench = np.zeros(6)
    seen = len(user.joints)
    ros.until(lambda: len(user.joints) > seen + 20, "joint states")
    before, seen = len(user.wrenches), len(user.joints)
    ros.until(lambda: len(user.joints) > seen + 50, "more joint states")
    assert len(user.wrenches) == before
    refused = ros.ask(user.tare, Trigger.Request())
    assert not refused.success
    assert "singularity" in refused.message


def test_the_node_keeps_trying_to_reach_the_robot_and_says_why(ros: Any) -> None:
    from franka_suction_driver.arm_node import ArmNode
    from franka_suction_driver.backends.panda import PandaArm

    user = ros.add(make_user())
    node = ros.add(ArmNode, backend="panda")
    assert isinstance(node._backend, PandaArm)
    # Here panda-python is missing, or the address is: either is named with its remedy.
    ros.until(lambda: "arm_node" in user.said, "the heartbeat")
    ros.until(
        lambda: any(word in user.said["arm_node"][1] for word in ("panda-python", "robot_ip")),
        "the reason",
    )
    assert not user.said["arm_node"][0]


def test_the_motion_node_hears_best_effort_wrenches(ros: Any) -> None:
    """The trap: Franka's drivers publish wrenches best effort; a reliable reader gets nothing."""
    from rclpy.qos import ReliabilityPolicy

    from franka_suction_driver.motion_node import MotionNode

    node = ros.add(MotionNode)
    (reader,) = node.get_subscriptions_info_by_topic("external_wrench")
    assert reader.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT


@pytest.mark.parametrize("fault", ["killed", "reflex"])
def test_a_motion_ends_when_its_backend_does(ros: Any, fault: str) -> None:
    """The backend is killed, or the robot stops itself, in the middle of a motion."""
    from rclpy.action import ActionClient

    from flowbothd_interfaces.action import Approach
    from franka_suction_driver.arm_node import ArmNode
    from franka_suction_driver.motion_node import MotionNode

    arm = ros.add(ArmNode, backend="mock", heartbeat_timeout=0.5)
    motion = ros.add(
        MotionNode,
        safety__speed_scale=0.5,
        input_timeout=0.4,
        watch_nodes=["arm_node"],
        ready_nodes=["arm_node"],
    )
    robot = arm._backend._library.robot
    client = ActionClient(motion, Approach, "motion/approach")
    ros.until(client.server_is_ready, "the action server")
    ros.until(lambda: not motion._inputs.stale(guarded=False), "the robot's inputs")
    goal = Approach.Goal()
    goal.contact.x, goal.contact.y, goal.contact.z = 0.55, 0.1, 0.3
    goal.direction.x = -1.0
    sent = client.send_goal_async(goal)
    ros.until(sent.done, "the goal's acceptance")
    future = sent.result().get_result_async()
    ros.until(lambda: bool(np.abs(robot.dq).max() > 0.05), "the motion")
    if fault == "killed":
        ros.remove(arm)
    else:
        robot.reflex("cartesian_reflex")
    ros.until(future.done, "the result", 10.0)
    result = future.result().result.result
    assert result.reason == "stale_input", result.message
    assert "arm_node" in result.message or "joint_states" in result.message
    if fault == "reflex":
        assert "cartesian_reflex" in result.message
    assert not motion._core.busy
    client.destroy()


@pytest.fixture
def start_process(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Starts hardware nodes as processes; none outlives the test."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    started: list[subprocess.Popen] = []

    def start(module: str, *parameters: str) -> subprocess.Popen:
        given = [word for parameter in parameters for word in ("-p", parameter)]
        command = [sys.executable, "-m", f"franka_suction_driver.{module}", "--ros-args", *given]
        started.append(subprocess.Popen(command, stderr=subprocess.DEVNULL))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait(timeout=10)


def test_killed_hardware_processes_end_the_motion_and_the_pump_is_known_to_be_lost(
    ros: Any, start_process: Any
) -> None:
    """SIGKILL, no last words: what is left knows that arm and pump are gone, and says so."""
    from rclpy.action import ActionClient

    from flowbothd_interfaces.action import Approach
    from flowbothd_interfaces.msg import SuctionState
    from franka_suction_driver.motion_node import MotionNode
    from franka_suction_driver.suction.suction_node import SuctionNode

    arm = start_process("arm_node", "backend:=mock", "heartbeat_timeout:=0.8")
    pump = start_process("pump_node", "backend:=mock")
    watched = {"watch_nodes": ["arm_node"], "ready_nodes": ["arm_node"]}
    motion = ros.add(MotionNode, safety__speed_scale=0.5, input_timeout=0.4, **watched)
    suction = ros.add(SuctionNode)
    phases: list[int] = []
    motion.create_subscription(SuctionState, "suction/state", lambda m: phases.append(m.state), 10)
    client = ActionClient(motion, Approach, "motion/approach")
    ros.until(client.server_is_ready, "the action server")
    ros.until(lambda: not motion._inputs.stale(guarded=True), "arm and suction")
    ros.until(lambda: bool(phases) and phases[-1] == SuctionState.OFF, "the pump")
    goal = Approach.Goal()
    goal.contact.x, goal.contact.y, goal.contact.z = 0.55, 0.1, 0.3
    goal.direction.x = -1.0
    _, future = ros.send(client, goal)

    def speed() -> float:
        seen = motion._inputs.observation()
        return 0.0 if seen is None else float(np.abs(seen.velocities).max())

    ros.until(lambda: speed() > 0.05, "the motion")
    arm.kill()
    pump.kill()
    result = ros.result(future, seconds=10.0)
    assert result.reason == "stale_input", result.message
    assert "arm_node" in result.message or "joint_states" in result.message
    assert not motion._core.busy
    ros.until(lambda: phases[-1] == SuctionState.FAULT, "the pump's fault", seconds=5.0)
    assert "no measurement" in suction._machine.status(time.monotonic()).message
    client.destroy()


class TestTopic:
    """A robot behind a JointTrajectoryController."""

    @pytest.fixture
    def controller(self, ros: Any) -> Any:
        from sensor_msgs.msg import JointState

        from franka_suction_driver.arm_node import ArmNode

        user = ros.add(make_user())
        node = ros.add(ArmNode, backend="topic", heartbeat_timeout=0.3)
        start = np.array(node._params.robot.start_positions)
        state = {"q": start}

        def speak() -> None:
            # In another order than ours: joints go by name.
            user.robot.publish(
                JointState(name=list(node._names)[::-1], position=state["q"][::-1].tolist())
            )

        user.create_timer(0.01, speak)
        ros.until(lambda: node._backend.state() is not None, "joint states")
        ros.until(lambda: not node._holding, "the heartbeat")
        ros.until(lambda: user.trajectory.get_subscription_count() > 0, "the trajectory's reader")
        return user, node, state

    def test_a_trajectory_is_passed_on_with_stamp_zero_and_all_three_columns(
        self, ros: Any, controller: Any, limits: Any
    ) -> None:
        user, node, state = controller
        user.trajectory.publish(trajectory(state["q"], 0.05, limits, node._names))
        ros.until(lambda: bool(user.passed_on), "the trajectory")
        message = user.passed_on[0]
        assert message.header.stamp.sec == 0
        assert message.points[0].time_from_start.nanosec > 0
        last = message.points[-1]
        assert not any(last.velocities)
        assert not any(last.accelerations)

    def test_a_controller_that_rejects_in_silence_is_found_out(
        self, ros: Any, controller: Any, limits: Any
    ) -> None:
        """The trap: a rejected trajectory leaves one line in the controller's own log."""
        from std_srvs.srv import Trigger

        user, node, state = controller
        user.trajectory.publish(trajectory(state["q"], 0.4, limits, node._names))
        ros.until(lambda: "rejected" in user.said.get("arm_node", (True, ""))[1], "the fault")
        user.trajectory.publish(trajectory(state["q"], 0.05, limits, node._names))
        ros.until(lambda: "rejected" in node._refused, "the refusal")
        assert len(user.passed_on) == 1
        assert ros.ask(user.recover, Trigger.Request()).success
        user.trajectory.publish(trajectory(state["q"], 0.05, limits, node._names))
        ros.until(lambda: len(user.passed_on) == 2, "the trajectory after recovery")

    def test_silence_of_the_planner_sends_a_braking_trajectory(
        self, ros: Any, controller: Any, limits: Any
    ) -> None:
        """The trap: an empty trajectory is an error on the topic; a stop is a short motion."""
        user, node, state = controller
        user.trajectory.publish(trajectory(state["q"], 2.0, limits, node._names))
        ros.until(lambda: bool(user.passed_on), "the trajectory")
        user.beating = False
        ros.until(lambda: len(user.passed_on) == 2, "the stop", seconds=3.0)
        stop = user.passed_on[1]
        assert stop.points
        assert not any(stop.points[-1].velocities)


def test_the_pump_holds_loses_and_is_released_when_the_node_goes(ros: Any) -> None:
    from flowbothd_interfaces.msg import SuctionState
    from flowbothd_interfaces.srv import SetSuction
    from franka_suction_driver.pump_node import PumpNode
    from franka_suction_driver.suction.suction_node import SuctionNode

    pump = ros.add(PumpNode, backend="mock", poll_rate=50.0)
    suction = ros.add(SuctionNode)
    client = suction.create_client(SetSuction, "suction/set")
    robot = pump._pump._library.robot

    def phase_is(name: str) -> Callable[[], bool]:
        return lambda: suction._machine.status(time.monotonic()).phase.value == name

    ros.until(phase_is("off"), "the first measurement")
    ros.until(lambda: pump._connection.made, "the pump")
    assert ros.ask(client, SetSuction.Request(vacuum=60000.0)).success
    ros.until(phase_is("building"), "building")
    robot.pump.sealed = True
    ros.until(phase_is("holding"), "holding")
    robot.pump.sealed = False
    ros.until(phase_is("lost"), "lost")
    assert ros.ask(client, SetSuction.Request(vacuum=0.0)).success
    ros.until(phase_is("off"), "off")
    # Too little for the pump's own threshold: nobody waits for an answer, so it is a fault.
    assert ros.ask(client, SetSuction.Request(vacuum=20000.0)).success
    ros.until(phase_is("fault"), "the fault")
    assert "threshold" in suction._machine.status(time.monotonic()).message
    robot.pump.sealed = True
    assert ros.ask(client, SetSuction.Request(vacuum=60000.0)).success
    ros.until(lambda: robot.pump.held, "holding again")
    ros.remove(pump)
    assert robot.names()[-2:] == ["drop_off", "stop"]
    assert SuctionState.FAULT == 4


def test_each_blocking_part_has_a_process_of_its_own() -> None:
    """The trap: read_once holds Python's lock until a packet comes.

    In the arm's or the planner's process it would make targets and heartbeats stutter.
    """
    import inspect

    from franka_suction_driver import arm_node, motion_node
    from franka_suction_driver.suction import suction_node

    for module in (arm_node, motion_node, suction_node):
        assert "cobot_pump" not in inspect.getsource(module)
