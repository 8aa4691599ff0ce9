"""No value enters unchecked: malformed messages while the arm moves, and the force they cost."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = [pytest.mark.ros, pytest.mark.long]

DOMAIN = 78
TABLE_STIFFNESS = 5000.0
"""[N/m]"""
FELT = ("contact", "force_limit")
"""Reasons of a probe that has felt the table."""
PARAMETERS = {
    "safety__speed_scale": 1.0,
    "use_sim_time": True,
    # Two nodes and a planner share one process here.
    "input_timeout": 3.0,
    "clock_timeout": 1.5,
    "stamp_tolerance": 10.0,
}


def make_arm() -> Any:
    """A stand-in for arm, force sensor, pump and camera, over a table.

    It follows trajectories exactly, in simulated time that goes on by 10 ms a tick. `spoil` maps
    a topic to a function that replaces its message.
    """
    from geometry_msgs.msg import WrenchStamped
    from rclpy.node import Node
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Header
    from trajectory_msgs.msg import JointTrajectory

    from flowbothd_common.motion import JointState as State
    from flowbothd_common.ros import clouds, qos, received
    from flowbothd_common.ros.conversions import to_stamp
    from flowbothd_interfaces.msg import MotionResult, SuctionState
    from franka_suction_driver.arm.kinematics import make_kinematics
    from franka_suction_driver.arm.trajectory import state_at
    from franka_suction_driver.params import MotionParams

    names = MotionParams().robot.joint_names
    robot = make_kinematics(MotionParams())

    class Arm(Node):
        def __init__(self, **kwargs: Any) -> None:
            super().__init__("arm", **kwargs)
            self.state = State.at_rest(np.array(MotionParams().robot.start_positions))
            self.table = -10.0
            self.holding = False
            self.spoil: dict[str, Callable[[Any, int], Any]] = {}
            self.peak = 0.0
            self.count = 0
            self.time = 100.0
            self.clock_runs = True
            self.bad_since: float | None = None
            self.rested_after: float | None = None
            self.commands: list[Any] = []
            self.results: list[Any] = []
            self._running: tuple[float, State, Any] | None = None
            make = self.create_publisher
            self.outputs = {
                "joint_states": make(JointState, "joint_states", qos.STATE),
                "external_wrench": make(WrenchStamped, "external_wrench", qos.SENSOR),
                "suction/state": make(SuctionState, "suction/state", qos.STATE),
                "object_cloud": make(clouds.PointCloud2, "object_cloud", qos.IMAGE),
            }
            self.under_way = 0
            self._clock_topic = make(Clock, "/clock", 10)
            listen = self.create_subscription
            listen(JointTrajectory, "joint_trajectory", self._on_trajectory, qos.COMMAND)
            listen(MotionResult, "motion/result", self.results.append, qos.EVENT)
            listen(JointState, "joint_states", self._on_echo, qos.STATE)
            listen(WrenchStamped, "external_wrench", self._on_echo, qos.SENSOR)

        def tip(self) -> np.ndarray:
            return robot.tip(self.state.position).position

        def _on_trajectory(self, message: Any) -> None:
            # What leaves motion_node is complete, finite, and of our joints, or this raises.
            trajectory = received.trajectory(message, names)
            self.commands.append(trajectory)
            self._running = (self.time, self.state, trajectory)

        def _on_echo(self, _: Any) -> None:
            self.under_way -= 1

        def tick(self) -> None:
            """Move on by 10 ms and publish."""
            self.under_way = 2
            self.time += 0.01
            now = self.time
            if self.clock_runs:
                self._clock_topic.publish(Clock(clock=to_stamp(now)))
            if self._running is not None:
                since, entered, trajectory = self._running
                self.state = state_at(trajectory, entered, now - since)
            force = TABLE_STIFFNESS * max(0.0, self.table - float(self.tip()[2]))
            self.peak = max(self.peak, force)
            moving = bool(self.state.velocity.any())
            if self.bad_since is not None and self.rested_after is None and not moving:
                self.rested_after = now - self.bad_since
            self.count += 1
            for topic, message in self.good(force).items():
                sent = message
                if topic in self.spoil:
                    sent = self.spoil[topic](message, self.count)
                if sent is not message and self.bad_since is None:
                    self.bad_since = now
                self.outputs[topic].publish(sent)

        def good(self, force: float = 0.0) -> dict[str, Any]:
            """One well-formed message of every topic."""
            header = Header(stamp=to_stamp(self.time), frame_id="panda_link0")
            joints = JointState(header=header, name=list(reversed(names)))
            joints.position = self.state.position[::-1].tolist()
            joints.velocity = self.state.velocity[::-1].tolist()
            wrench = WrenchStamped(header=header)
            wrench.wrench.force.z = force
            state = SuctionState.HOLDING if self.holding else SuctionState.OFF
            cloud = clouds.to_cloud_message(header, np.full((4, 3), 3.0), clouds.XYZ)
            return {
                "joint_states": joints,
                "external_wrench": wrench,
                "suction/state": SuctionState(header=header, state=state),
                "object_cloud": cloud,
            }

    return Arm


class Bench:
    """motion_node with the stand-in, and clients for its four motions.

    Arm, messages and control take turns, so that a busy machine changes nothing: a tick of the arm,
    its messages, and at every second tick the node's control timer (50 Hz).
    """

    def __init__(self, ros: Any, **overrides: Any) -> None:
        from rclpy.action import ActionClient

        from flowbothd_interfaces.action import Approach, FlowStep, Probe, Retreat
        from franka_suction_driver.motion_node import MotionNode

        self.ros = ros
        self.arm = ros.add(make_arm())
        self.node = ros.add(MotionNode, **{**PARAMETERS, **overrides})
        actions = {
            "approach": Approach,
            "probe": Probe,
            "flow_step": FlowStep,
            "retreat": Retreat,
        }
        for timer in self.node.timers:
            timer.cancel()
        self.goals = {name: action.Goal for name, action in actions.items()}
        self.clients = {
            name: ActionClient(self.arm, action, f"motion/{name}")
            for name, action in actions.items()
        }
        self.settle()

    def step(self) -> None:
        """One tick of the arm, with all that it brings about."""
        self.arm.tick()
        deadline = time.monotonic() + 0.3
        while self.arm.under_way > 0 and time.monotonic() < deadline:
            self.ros.spin()
        for _ in range(6):
            self.ros.spin(0.0)
        if self.arm.count % 2 == 0:
            self.node._guard.run("timer", self.node._on_timer)
            self.ros.spin(0.001)

    def until(self, condition: Callable[[], bool], what: str, seconds: float = 60.0) -> None:
        """Step until the condition holds; fails after `seconds` of the wall clock."""
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f"{what} did not come in {seconds} s"
            self.step()

    def settle(self) -> None:
        """Wait until good values arrive and the arm rests."""
        self.arm.spoil, self.arm.bad_since, self.arm.rested_after = {}, None, None
        inputs, runner = self.node._inputs, self.node._runner
        self.until(lambda: not runner.busy, "the end of the motion")
        self.until(lambda: not inputs.stale(guarded=True), "the robot's inputs")
        self.until(lambda: not self.arm.state.velocity.any(), "the arm at rest")
        self.arm.commands.clear()
        self.arm.results.clear()

    def goal(self, name: str) -> Any:
        goal = self.goals[name]()
        if name in ("probe", "flow_step"):
            goal.direction.z = -1.0 if name == "probe" else 1.0
        if name == "approach":
            goal.contact.x, goal.contact.y, goal.contact.z = 0.5, 0.1, 0.3
            goal.direction.x = -1.0
        if hasattr(goal, "joint"):
            # A hinge that opens upwards, behind the contact.
            goal.joint.kind = goal.joint.REVOLUTE
            goal.joint.point.x, goal.joint.point.z, goal.joint.axis.y = 0.7, 0.1, 1.0
        return goal

    def start(self, name: str) -> Any:
        """Start a motion and wait until the arm moves; returns the future of its result."""
        self.arm.holding = name == "flow_step"
        if name == "flow_step":
            self.until(lambda: self.node._inputs.observation().vacuum, "vacuum")
        _, future = self.ros.send(self.clients[name], self.goal(name))
        self.until(lambda: bool(self.arm.commands) or future.done(), "the motion")
        if not future.done():
            moving = lambda: np.abs(self.arm.state.velocity).max() > 1e-3  # noqa: E731
            self.until(moving, "movement")
        return future

    def finish(self, future: Any) -> Any:
        self.until(future.done, "the result")
        return future.result().result.result

    def close(self) -> None:
        for client in self.clients.values():
            client.destroy()


@pytest.fixture
def bench(ros: Any) -> Any:
    made: list[Bench] = []

    def make(**overrides: Any) -> Bench:
        made.append(Bench(ros, **overrides))
        return made[-1]

    yield make
    for each in made:
        each.close()


def nan_wrench(message: Any) -> Any:
    bad = copy.deepcopy(message)
    bad.wrench.force.y = float("nan")
    return bad


def probe_the_table(
    bench: Bench, spoil: Callable[[Any, int], Any] | None = None
) -> tuple[float, Any]:
    """Probe at full speed onto a table 4 cm below; returns the peak force [N] and the result."""
    arm = bench.arm
    bench.settle()
    arm.table = float(arm.tip()[2]) - 0.04
    arm.peak = 0.0
    if spoil is not None:
        arm.spoil["external_wrench"] = spoil
    _, future = bench.ros.send(bench.clients["probe"], bench.goal("probe"))
    result = bench.finish(future)
    peak = arm.peak
    arm.table = -10.0
    bench.settle()
    bench.finish(bench.start("retreat"))
    return peak, result


def test_a_wrench_that_is_no_number_presses_no_harder_than_a_good_one(bench: Any) -> None:
    """The incident: a wrench with one NaN, and a probe pressed 350 N into a table.

    It reported `no_contact`, peak 0.0 N, since `nan > limit` is false. One NaN among good ones
    poisoned the filter for the rest of the motion (74 and 96 N).
    """
    rig = bench(safety__force_limit=400.0)
    arm = rig.arm
    good, result = probe_the_table(rig)
    assert result.reason in FELT, result.message
    assert 5.0 < good < 60.0

    from_start, result = probe_the_table(rig, lambda m, _: nan_wrench(m))
    assert result.reason == "stale_input"
    assert "wrench" in result.message
    assert from_start == 0.0

    for above in (0.01, 0.002, 0.0, -0.001, -0.002):

        def late(message: Any, _: int, above: float = above) -> Any:
            reached = arm.tip()[2] < arm.table + above
            return nan_wrench(message) if reached else message

        force, result = probe_the_table(rig, late)
        assert result.reason in ("stale_input", *FELT), result.message
        assert force <= 1.1 * good, f"{force:.1f} N, {good:.1f} N with good values"

    spoiled: list[int] = []

    def once(message: Any, count: int) -> Any:
        if not spoiled and arm.tip()[2] < arm.table + 0.01:
            spoiled.append(count)
            return nan_wrench(message)
        return message

    force, result = probe_the_table(rig, once)
    assert spoiled
    assert result.reason in FELT, result.message
    assert force <= 1.1 * good


NEEDED = {
    "approach": ("joint_states", "external_wrench"),
    "probe": ("joint_states", "external_wrench", "suction/state"),
    "flow_step": ("joint_states", "external_wrench", "suction/state"),
    "retreat": ("joint_states", "external_wrench"),
}
"""Topics without which a motion that began with them must not go on."""

REST = 0.1
"""Longest time from the first malformed message to an arm at rest, at a lab's default speed [s]."""


def refused_copies(good: dict[str, Any]) -> list[tuple[str, str, Any]]:
    """Topic, what is wrong and message, of messages that nothing can be read from."""
    from flowbothd_common.ros.malformed import malformations

    wrong = {
        "joint_states": ("position with nan", "position short", "name empty", "stamp past"),
        "external_wrench": ("force.z nan", "torque.x -inf", "frame_id other", "stamp future"),
        "suction/state": ("state 255",),
    }
    return [
        (topic, label, bad)
        for topic, wanted in wrong.items()
        for label, bad in malformations(good[topic])
        if label.endswith(wanted)
    ]


def spoiler(bad: Any) -> Callable[[Any, int], Any]:
    """Replace every message by `bad`, with a stamp of its time unless that is what is wrong."""

    def spoil(message: Any, _: int) -> Any:
        sent = copy.deepcopy(bad)
        if abs(sent.header.stamp.sec - message.header.stamp.sec) < 60:
            sent.header.stamp = message.header.stamp
        return sent

    return spoil


@pytest.mark.parametrize("motion", list(NEEDED))
def test_the_arm_rests_when_an_input_that_it_needs_is_malformed(bench: Any, motion: str) -> None:
    """The incident: joint states with names and no positions, legal in ROS, ended motion_node."""
    rig = bench(safety__speed_scale=0.1)
    cases = refused_copies(rig.arm.good())
    assert len(cases) >= 9
    # Every case with one motion would take minutes: each motion takes its share.
    share = cases[list(NEEDED).index(motion) % 2 :: 2]
    for topic, label, bad in share:
        if topic not in NEEDED[motion]:
            continue
        rig.settle()
        future = rig.start(motion)
        if future.done():
            rig.finish(rig.start("retreat"))
            future = rig.start(motion)
        rig.arm.spoil[topic] = spoiler(bad)
        result = rig.finish(future)
        what = f"{motion}, {topic}: {label}"
        assert result.reason == "stale_input", f"{what}: {result.reason} {result.message}"
        assert topic in result.message, what
        rig.until(lambda: rig.arm.rested_after is not None, "rest")
        assert rig.arm.rested_after <= REST, f"{what}: {rig.arm.rested_after:.3f} s"


@pytest.mark.parametrize("motion", list(NEEDED))
def test_one_malformed_message_among_many_good_ones_stops_nothing(bench: Any, motion: str) -> None:
    """Every kind of malformation of every topic, each once, while the arm moves and after."""
    from flowbothd_common.ros.malformed import malformations

    rig = bench()
    rig.settle()
    queues = {
        topic: [bad for _, bad in malformations(good)] for topic, good in rig.arm.good().items()
    }
    assert all(len(queue) > 10 for queue in queues.values())

    def spoil(topic: str) -> Callable[[Any, int], Any]:
        offset = list(queues).index(topic)

        def replaced(message: Any, count: int) -> Any:
            if (count + offset) % 8 or not queues[topic]:
                return message
            return spoiler(queues[topic].pop())(message, count)

        return replaced

    future = rig.start(motion)
    rig.arm.spoil = {topic: spoil(topic) for topic in queues}
    # A good value of another kind is legal: HOLDING turned into LOST does end a step.
    legal = {"reached", "no_contact", "vacuum", "contact", "suction_lost", "force_limit"}
    assert rig.finish(future).reason in legal
    rig.until(lambda: not any(queues.values()), "all malformed messages", 60.0)
    rig.settle()
    assert rig.finish(rig.start("retreat")).reason == "reached"


def test_malformed_goals_end_with_a_reason_and_the_next_good_one_runs(bench: Any) -> None:
    from flowbothd_common.ros.malformed import malformations

    rig = bench()
    bad = [
        (motion, label, goal)
        for motion in NEEDED
        for label, goal in malformations(rig.goal(motion))
        if label.endswith((" nan", " inf", " -inf", " other", "kind 255"))
    ]
    assert len(bad) > 20
    rig.settle()
    for motion, label, goal in bad:
        _, future = rig.ros.send(rig.clients[motion], goal)
        result = rig.finish(future)
        assert result.reason == "rejected", f"{motion} {label}: {result.reason}"
        assert result.message
    rig.settle()
    assert rig.finish(rig.start("retreat")).reason == "reached"


def test_a_clock_that_stands_still_is_a_lost_input(bench: Any) -> None:
    """The incident: /clock stopped, joint states went on, and a retreat moved and never ended."""
    rig = bench(safety__speed_scale=0.1)
    rig.settle()
    future = rig.start("approach")
    rig.arm.clock_runs = False
    result = rig.finish(future)
    assert result.reason == "stale_input"
    assert "clock has stood still" in result.message
    rig.until(lambda: not rig.arm.state.velocity.any(), "the arm at rest")
    _, refused = rig.ros.send(rig.clients["retreat"], rig.goal("retreat"))
    assert "clock has stood still" in rig.finish(refused).message
    rig.arm.clock_runs = True
    rig.settle()
    assert rig.finish(rig.start("retreat")).reason == "reached"


def test_an_exception_in_a_motion_brakes_the_arm_and_the_node_goes_on(bench: Any) -> None:
    """The incident: any exception in a callback ended motion_node in mid-motion."""
    rig = bench(safety__speed_scale=0.1)
    rig.settle()
    future = rig.start("approach")
    running = rig.node._core._running

    class Broken:
        fraction = 0.5

        def tick(self, *_: Any) -> None:
            raise ZeroDivisionError("broken motion")

        stop = tick

    rig.node._core._running = Broken()
    result = rig.finish(future)
    assert running is not None
    assert result.reason == "stopped"
    assert "ZeroDivisionError" in result.message
    rig.until(lambda: not rig.arm.state.velocity.any(), "the arm at rest")
    assert any("ZeroDivisionError" in text for text in rig.node._guard.troubles())
    assert rig.finish(rig.start("retreat")).reason == "reached"


def test_the_wrench_of_a_driver_with_the_other_sign_is_turned(bench: Any) -> None:
    """The incident: with franka_ros's sign no contact was felt below 42 N."""
    rig = bench(wrench__sign=-1.0)
    rig.arm.spoil["external_wrench"] = lambda message, _: message
    rig.settle()
    rig.arm.table = float(rig.arm.tip()[2]) + 0.001
    rig.until(lambda: bool(rig.node._inputs.observation().wrench.any()), "a force")
    assert rig.node._inputs.observation().wrench[2] == pytest.approx(-0.001 * TABLE_STIFFNESS)


def test_a_sign_that_is_none_is_refused(bench: Any) -> None:
    from flowbothd_common.errors import ParameterError

    with pytest.raises(ParameterError, match=r"wrench\.sign"):
        bench(wrench__sign=0.5)


def test_an_arm_that_cannot_be_braked_is_left_to_its_driver_and_said_so(bench: Any) -> None:
    """The incident: the heartbeat stopped for good while diagnostics went on as "ready to move"."""
    rig = bench()

    def broken(*_: Any) -> None:
        raise ZeroDivisionError("broken brake")

    rig.node._core.drop = broken
    rig.node._guard.fail("motion", RuntimeError("broken motion"))
    assert rig.node._heartbeat.silent
    rig.node._on_timer()
    level, message = rig.node._status._said
    assert level == b"\x02"
    assert "cannot brake" in message
