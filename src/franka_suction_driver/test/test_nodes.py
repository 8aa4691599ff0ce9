"""motion_node and suction_node in process, against a recording stand-in for the bridge."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

DOMAIN = 73


def make_bridge() -> Any:
    """Stand-in for bridge and suction: follows trajectories exactly, on the wall clock."""
    from geometry_msgs.msg import WrenchStamped
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Header, String
    from trajectory_msgs.msg import JointTrajectory

    from flowbothd_common.motion import JointState as State
    from flowbothd_common.ros import qos
    from flowbothd_interfaces.msg import SuctionCommand, SuctionMeasurement, SuctionState
    from franka_suction_driver.arm.trajectory import state_at
    from franka_suction_driver.params import MotionParams

    names = MotionParams().robot.joint_names

    class Bridge(Node):
        def __init__(self, **kwargs: Any) -> None:
            super().__init__("bridge", **kwargs)
            self.state = State.at_rest(np.array(MotionParams().robot.start_positions))
            self.speaking = True
            self.received: list[JointTrajectory] = []
            self.beats = 0
            self.description = ""
            self.suction_commands: list[float] = []
            self.suction_states: list[SuctionState] = []
            self.part_present = False
            self._running: tuple[float, State, Any] | None = None
            self._joints = self.create_publisher(JointState, "joint_states", qos.STATE)
            self._wrench = self.create_publisher(WrenchStamped, "external_wrench", qos.SENSOR)
            self._suction = self.create_publisher(SuctionState, "suction/state", qos.STATE)
            self._measure = self.create_publisher(
                SuctionMeasurement, "suction/measurement", qos.STATE
            )
            self.create_subscription(
                JointTrajectory, "joint_trajectory", self._on_trajectory, qos.COMMAND
            )
            self.create_subscription(
                SuctionCommand,
                "suction/command",
                lambda m: self.suction_commands.append(m.vacuum),
                qos.COMMAND,
            )
            self.create_subscription(
                SuctionState, "suction/state", self.suction_states.append, qos.STATE
            )
            self.create_subscription(Header, "motion/heartbeat", self._on_beat, qos.HEARTBEAT)
            self.create_subscription(String, "robot_description", self._on_description, qos.LATCHED)
            self.create_timer(0.01, self._tick)
            self.suction_node_runs = False

        def _on_beat(self, _: Header) -> None:
            self.beats += 1

        def _on_description(self, message: String) -> None:
            self.description = message.data

        def _on_trajectory(self, message: JointTrajectory) -> None:
            from flowbothd_common.motion import JointTrajectory as Trajectory

            self.received.append(message)
            points = message.points
            trajectory = Trajectory(
                tuple(message.joint_names),
                np.array(
                    [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points]
                ),
                np.array([p.positions for p in points]),
                np.array([p.velocities for p in points]),
                np.array([p.accelerations for p in points]),
            )
            self._running = (time.monotonic(), self.state, trajectory)

        def _tick(self) -> None:
            if self._running is not None:
                since, entered, trajectory = self._running
                self.state = state_at(trajectory, entered, time.monotonic() - since)
            if not self.speaking:
                return
            stamp = self.get_clock().now().to_msg()
            joints = JointState(name=list(reversed(names)))
            joints.header.stamp = stamp
            joints.position = self.state.position[::-1].tolist()
            joints.velocity = self.state.velocity[::-1].tolist()
            self._joints.publish(joints)
            self._wrench.publish(WrenchStamped())
            if not self.suction_node_runs:
                self._suction.publish(SuctionState(state=SuctionState.OFF))
            measurement = SuctionMeasurement(part_present=self.part_present)
            measurement.vacuum = 6e4 if self.part_present else 0.0
            self._measure.publish(measurement)

    return Bridge


def approach_goal(**changes: Any) -> Any:
    from flowbothd_interfaces.action import Approach

    goal = Approach.Goal()
    goal.contact.x, goal.contact.y, goal.contact.z = 0.55, 0.1, 0.3
    goal.direction.x = -1.0
    for name, value in changes.items():
        setattr(goal, name, value)
    return goal


@pytest.fixture
def motion(ros: Any):
    """motion_node with a bridge that speaks, ready to move."""
    from rclpy.action import ActionClient

    from flowbothd_interfaces.action import Approach, Probe
    from franka_suction_driver.motion_node import MotionNode

    bridge = ros.add(make_bridge())
    node = ros.add(MotionNode, robot__speed_scale=1.0, safety__speed_scale=1.0, input_timeout=0.5)
    clients = {
        "approach": ActionClient(bridge, Approach, "motion/approach"),
        "probe": ActionClient(bridge, Probe, "motion/probe"),
    }
    ros.until(lambda: bridge.beats > 3 and bool(bridge.description), "heartbeat and description")
    ros.until(lambda: not node._inputs.stale(guarded=True), "the robot's inputs")
    yield bridge, node, clients
    for client in clients.values():
        client.destroy()


def test_an_approach_moves_the_arm_and_beats_while_planning(ros: Any, motion: Any) -> None:
    bridge, node, clients = motion
    assert "suction_tip" in bridge.description
    _, future = ros.send(clients["approach"], approach_goal())
    before = bridge.beats
    result = ros.result(future)
    assert result.reason == "reached", result.message
    assert result.header.frame_id == "panda_link0"
    assert len(bridge.received) == 1
    tip = node._core.robot.tip(bridge.state.position).position
    np.testing.assert_allclose(tip, [0.45, 0.1, 0.3], atol=2e-3)
    assert result.tool_end.position.x == pytest.approx(tip[0], abs=2e-3)
    assert bridge.beats - before > 10


def test_a_second_goal_is_rejected_with_a_reason_and_stop_stops(ros: Any, motion: Any) -> None:
    from std_srvs.srv import Trigger

    bridge, _, clients = motion
    _, first = ros.send(clients["approach"], approach_goal())
    _, second = ros.send(clients["approach"], approach_goal())
    refused = ros.result(second)
    assert refused.reason == "rejected"
    assert "approach is still running" in refused.message
    ros.until(lambda: bool(bridge.received), "the motion")
    stop = bridge.create_client(Trigger, "motion/stop")
    ros.until(stop.service_is_ready, "the stop service")
    answer = stop.call_async(Trigger.Request())
    stopped = ros.result(first)
    assert stopped.reason == "stopped"
    assert answer.result().message == "stopping"
    assert len(bridge.received) == 2
    # The arm began a message's way later than motion counted, and ends as much later.
    ros.until(lambda: not bridge.state.velocity.any(), "the arm at rest")


def test_cancelling_stops_the_motion(ros: Any, motion: Any) -> None:
    bridge, _, clients = motion
    handle, future = ros.send(clients["approach"], approach_goal())
    ros.until(lambda: bool(bridge.received), "the motion")
    handle.cancel_goal_async()
    assert ros.result(future).reason == "stopped"


def test_silent_joint_states_stop_the_motion_and_are_named(ros: Any, motion: Any) -> None:
    bridge, _, clients = motion
    _, future = ros.send(clients["approach"], approach_goal())
    ros.until(lambda: bool(bridge.received), "the motion")
    bridge.speaking = False
    silent_since = time.monotonic()
    ros.until(lambda: len(bridge.received) > 1, "the stop", seconds=2.0)
    assert time.monotonic() - silent_since < 1.0
    result = ros.result(future, seconds=5.0)
    assert result.reason == "stale_input"
    assert "no joint_states for" in result.message
    _, blind = ros.send(clients["approach"], approach_goal())
    assert "joint_states" in ros.result(blind).message


def test_malformed_goals_are_refused_in_words(ros: Any, motion: Any) -> None:
    from geometry_msgs.msg import Point, Vector3
    from std_msgs.msg import Header

    _, _, clients = motion
    cases = {
        "without a direction": approach_goal(direction=Vector3()),
        "not finite": approach_goal(contact=Point(x=float("nan"))),
        "got map; allowed: panda_link0": approach_goal(header=Header(frame_id="map")),
        "outside the workspace box": approach_goal(contact=Point(x=3.0)),
        "no joint configuration": approach_goal(contact=Point(x=0.99, y=0.79, z=0.1)),
    }
    for words, goal in cases.items():
        _, future = ros.send(clients["approach"], goal)
        result = ros.result(future)
        assert result.reason in ("rejected", "unreachable")
        assert words in result.message


def test_a_watched_node_that_falls_silent_stops_the_motion(ros: Any) -> None:
    from rclpy.action import ActionClient

    from flowbothd_common.ros.liveness import HeartbeatPublisher
    from flowbothd_interfaces.action import Approach
    from franka_suction_driver.motion_node import MotionNode

    bridge = ros.add(make_bridge())
    node = ros.add(
        MotionNode,
        robot__speed_scale=0.3,
        safety__speed_scale=1.0,
        input_timeout=0.5,
        watch_nodes=["bridge"],
    )
    client = ActionClient(bridge, Approach, "motion/approach")
    beat = HeartbeatPublisher(bridge)
    ros.until(lambda: not node._inputs.stale(guarded=True), "heartbeat and inputs")
    _, future = ros.send(client, approach_goal())
    ros.until(lambda: bool(bridge.received), "the motion")
    beat.close()
    result = ros.result(future, seconds=5.0)
    assert result.reason == "stale_input"
    assert "bridge silent for" in result.message
    client.destroy()


def test_the_suction_node_passes_commands_on_and_tells_the_state(ros: Any) -> None:
    from flowbothd_interfaces.msg import SuctionState
    from flowbothd_interfaces.srv import SetSuction
    from franka_suction_driver.suction.suction_node import SuctionNode

    bridge = ros.add(make_bridge())
    bridge.suction_node_runs = True
    ros.add(SuctionNode)
    client = bridge.create_client(SetSuction, "suction/set")
    ros.until(client.service_is_ready, "suction/set")

    def ask(vacuum: float) -> Any:
        answer = client.call_async(SetSuction.Request(vacuum=vacuum))
        ros.until(answer.done, "the answer")
        return answer.result()

    def state_is(code: int) -> Callable[[], bool]:
        return lambda: bool(bridge.suction_states) and bridge.suction_states[-1].state == code

    refused = ask(-5.0)
    assert not refused.success
    assert "pascal" in refused.message
    assert ask(6e4).success
    ros.until(lambda: 6e4 in bridge.suction_commands, "the command")
    ros.until(state_is(SuctionState.BUILDING), "building")
    bridge.part_present = True
    ros.until(state_is(SuctionState.HOLDING), "holding")
    bridge.part_present = False
    ros.until(state_is(SuctionState.LOST), "lost")
    assert ask(0.0).success
    ros.until(state_is(SuctionState.OFF), "off")
    bridge.speaking = False
    ros.until(state_is(SuctionState.FAULT), "fault", seconds=3.0)
    assert "no measurement" in bridge.suction_states[-1].message
