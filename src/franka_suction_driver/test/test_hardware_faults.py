"""arm_node and pump_node when the robot is in a state of its own, or the cable is pulled."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

DOMAIN = 79


def make_operator() -> Any:
    """Somebody who beats, listens to the arm, and calls its services."""
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Header
    from std_srvs.srv import Trigger
    from trajectory_msgs.msg import JointTrajectory

    from flowbothd_common.ros import qos
    from flowbothd_interfaces.msg import Heartbeat

    class Operator(Node):
        def __init__(self, **kwargs: Any) -> None:
            super().__init__("operator", **kwargs)
            self.joints: list[np.ndarray] = []
            self.said: dict[str, tuple[bool, str]] = {}
            beat = self.create_publisher(Header, "motion/heartbeat", qos.HEARTBEAT)
            self.create_timer(0.02, lambda: beat.publish(Header()))
            self.trajectory = self.create_publisher(
                JointTrajectory, "joint_trajectory", qos.COMMAND
            )
            self.create_subscription(
                JointState,
                "joint_states",
                lambda m: self.joints.append(np.array(m.position)),
                qos.STATE,
            )
            self.create_subscription(Heartbeat, "heartbeat", self._on_heartbeat, qos.HEARTBEAT)
            self.recover = self.create_client(Trigger, "arm/recover")
            self.tare = self.create_client(Trigger, "arm/tare")

        def _on_heartbeat(self, message: Any) -> None:
            self.said[message.node] = (message.ready, message.detail)

        def hears(self, words: str) -> bool:
            return words in self.said.get("arm_node", (True, ""))[1]

    return Operator


def trajectory(start: np.ndarray, by: float, limits: Any, names: Any) -> Any:
    from flowbothd_common.motion import JointState
    from flowbothd_common.ros.conversions import to_trajectory
    from franka_suction_driver.arm.trajectory import joint_move

    return to_trajectory(joint_move(names, JointState.at_rest(start), start + by, limits))


@pytest.fixture
def bench(ros: Any) -> Any:
    """arm_node over the mock robot, before it has connected."""
    from franka_suction_driver.arm_node import ArmNode

    operator = ros.add(make_operator())
    node = ros.add(ArmNode, backend="mock", heartbeat_timeout=0.5)
    ros.until(lambda: operator.trajectory.get_subscription_count() > 0, "the reader")
    return operator, node, node._backend._library.robot


def begin_motion(ros: Any, bench: Any, limits: Any) -> np.ndarray:
    """Send a long motion, and return its end once the arm is under way."""
    operator, node, robot = bench
    ros.until(lambda: bool(operator.joints) and not node._holding, "an arm that follows")
    goal = robot.q - 0.6
    operator.trajectory.publish(trajectory(robot.q.copy(), -0.6, limits, node._names))
    ros.until(lambda: bool(np.abs(robot.dq).max() > 0.3), "the motion")
    return goal


def test_a_robot_that_starts_in_a_reflex_is_seen_and_recovered(ros: Any, limits: Any) -> None:
    """arm_node said "cannot reach the robot", and `arm/recover` "not connected", for ever."""
    from std_srvs.srv import Trigger

    from franka_suction_driver.arm_node import ArmNode
    from franka_suction_driver.backends.mock_modes import RobotMode

    operator = ros.add(make_operator())
    node = ros.add(ArmNode, backend="mock", heartbeat_timeout=0.5)
    robot = node._backend._library.robot
    robot.mode, robot.errors = RobotMode.kReflex, {"joint_reflex"}
    ros.until(lambda: operator.hears("joint_reflex"), "the state of the robot")
    ros.until(lambda: len(operator.joints) > 3, "measured joint states all the same")
    assert "start_controller" not in robot.names()
    assert ros.ask(operator.recover, Trigger.Request()).success
    begin_motion(ros, (operator, node, robot), limits)


def test_recover_with_nothing_wrong_says_so_and_the_arm_moves_on(
    ros: Any, bench: Any, limits: Any
) -> None:
    """`arm/recover` with nothing wrong stopped the controller at 1.34 rad/s.

    It is a success all the same: a script that asks before every run wants an arm without a
    fault, and has one.
    """
    from std_srvs.srv import Trigger

    operator, _, robot = bench
    goal = begin_motion(ros, bench, limits)
    answer = ros.ask(operator.recover, Trigger.Request())
    assert answer.success
    assert answer.message == "nothing to recover from"
    assert "stop_controller" not in robot.names()
    ros.until(lambda: np.allclose(robot.q, goal, atol=1e-3), "the end of the motion")


def test_a_pulled_cable_ends_no_node_and_recover_reconnects(
    ros: Any, bench: Any, limits: Any
) -> None:
    """A dead link ended arm_node at `arm/recover`, with the RuntimeError of the library."""
    from std_srvs.srv import Trigger

    operator, node, robot = bench
    begin_motion(ros, bench, limits)
    robot.unplug()
    seen = len(operator.joints)
    ros.until(lambda: operator.hears("no new state from the robot"), "the silence", seconds=5.0)
    # Those that were on their way when the cable was pulled.
    assert len(operator.joints) <= seen + 5
    ros.until(lambda: operator.hears("connection to the robot was lost"), "the loss", seconds=5.0)
    seen = len(operator.joints)
    assert not operator.said["arm_node"][0]
    refused = ros.ask(operator.recover, Trigger.Request())
    assert not refused.success
    assert "cannot reach the robot" in refused.message
    assert not ros.ask(operator.tare, Trigger.Request()).success
    assert len(operator.joints) == seen
    robot.plug_in()
    assert ros.ask(operator.recover, Trigger.Request()).success
    ros.until(lambda: len(operator.joints) > seen + 5, "joint states again")
    np.testing.assert_allclose(operator.joints[-1], robot.q)
    ros.until(lambda: not node._holding, "the heartbeat")
    begin_motion(ros, bench, limits)
    assert robot.crash == ""


def test_recover_leaves_a_moving_controller_behind_topics_alone(ros: Any, limits: Any) -> None:
    """`arm/recover` took a moving arm for resting where it was seen last.

    The next trajectory then began elsewhere than the controller was, and was refused or leapt.
    """
    from sensor_msgs.msg import JointState
    from std_srvs.srv import Trigger

    from flowbothd_common.ros import qos
    from franka_suction_driver.arm_node import ArmNode

    operator = ros.add(make_operator())
    node = ros.add(ArmNode, backend="topic", heartbeat_timeout=0.5)
    publisher = operator.create_publisher(JointState, "joint_states", qos.STATE)
    backend = node._backend
    start = np.array(node._params.robot.start_positions)
    names = list(node._names)

    def follow() -> None:
        moving = backend.state() is not None
        q = backend._commanded.state(time.monotonic()).position if moving else start
        publisher.publish(JointState(name=names, position=q.tolist()))

    operator.create_timer(0.01, follow)
    ros.until(lambda: backend.state() is not None and not node._holding, "an arm that follows")
    ros.until(lambda: operator.trajectory.get_subscription_count() > 0, "the reader")
    operator.trajectory.publish(trajectory(start, 0.6, limits, node._names))
    ros.until(lambda: float(backend._commanded.state(time.monotonic()).velocity[0]) > 0.3, "motion")
    answer = ros.ask(operator.recover, Trigger.Request())
    assert (answer.success, answer.message) == (True, "nothing to recover from")
    assert backend._commanded.state(time.monotonic()).velocity.any()
    ros.until(lambda: np.allclose(operator.joints[-1], start + 0.6, atol=1e-3), "the end")


def test_a_pump_that_cannot_be_reached_and_reports_nothing_usable_ends_no_node(ros: Any) -> None:
    """A vacuum of NaN went out as a measurement, and is neither above nor below any threshold."""
    from flowbothd_common.ros import qos
    from flowbothd_interfaces.msg import SuctionCommand, SuctionMeasurement
    from franka_suction_driver.pump_node import PumpNode

    operator = ros.add(make_operator())
    seen: list[Any] = []
    operator.create_subscription(SuctionMeasurement, "suction/measurement", seen.append, qos.STATE)
    command = operator.create_publisher(SuctionCommand, "suction/command", qos.COMMAND)
    pump = ros.add(PumpNode, backend="mock", poll_rate=50.0)
    robot = pump._pump._library.robot
    ros.until(lambda: bool(seen) and not seen[-1].fault, "a measurement")
    robot.pump.reported = float("nan")
    ros.until(lambda: seen[-1].fault and "no measurement" in seen[-1].fault_message, "the fault")
    assert np.isfinite(seen[-1].vacuum)
    robot.pump.reported = None
    ros.until(lambda: not seen[-1].fault, "measurements again")
    ros.until(lambda: command.get_subscription_count() > 0, "the command's reader")
    for vacuum in (float("nan"), float("inf"), float("-inf")):
        command.publish(SuctionCommand(vacuum=vacuum))
        ros.until(lambda: seen[-1].fault and "set-point" in seen[-1].fault_message, "the refusal")
        command.publish(SuctionCommand(vacuum=0.0))
        ros.until(lambda: not seen[-1].fault, "a good command")
    robot.unplug()
    ros.until(lambda: seen[-1].fault and "does not answer" in seen[-1].fault_message, "the loss")
