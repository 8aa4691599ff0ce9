"""Shared robot, a small recording arm, a Panda on a bench, and a ROS context."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flowbothd_common.motion import (
    JointState,
    JointTrajectory,
    MotionGoal,
    MotionResult,
    RobotObservation,
)
from flowbothd_common.parameters import build
from franka_suction_driver.arm.kinematics import Kinematics, make_kinematics
from franka_suction_driver.arm.limits import JointLimits, limits_from
from franka_suction_driver.arm.trajectory import joint_move, state_at
from franka_suction_driver.backend_params import PandaParams
from franka_suction_driver.backends.mock import MockLibrary, MockRobot
from franka_suction_driver.backends.panda import PandaArm
from franka_suction_driver.execution.executor import MotionExecutor
from franka_suction_driver.params import MotionParams

START = np.array(MotionParams().robot.start_positions)
Force = Callable[[np.ndarray], np.ndarray]


@pytest.fixture(scope="session")
def robot() -> Kinematics:
    return make_kinematics(MotionParams())


@pytest.fixture(scope="session")
def motion_params() -> MotionParams:
    """Parameters without the envelope's caution: full speed, no box, the motions' own guards."""
    safety = {
        "speed_scale": 1.0,
        "workspace_min": (-5.0,) * 3,
        "workspace_max": (5.0,) * 3,
        "force_limit": 1e4,
        "lag_limit": 1.0,
        "slow_singular_value": 0.0,
        "slow_margin": 0.0,
    }
    return build(MotionParams, {f"safety.{name}": value for name, value in safety.items()})


@pytest.fixture(scope="session")
def limits(robot: Kinematics) -> JointLimits:
    params = MotionParams().robot
    return limits_from(robot, params.acceleration_limits, params.jerk_limits)


class FakeArm:
    """An arm that does exactly what trajectories say, in a world given as a force field.

    Attributes:
        force: Maps the tip position (3,) to the force on the tool (3,) [N].
        vacuum: Maps the tip position to whether the cup holds.
        issued: Every trajectory with the time it came and the state it was entered from.
        fractions: Progress reported at every tick.
    """

    def __init__(self, robot: Kinematics, q: np.ndarray, period: float = 1 / 60) -> None:
        self.robot = robot
        self.period = period
        self.time = 5.0
        self.state = JointState.at_rest(q)
        self.force: Force = lambda tip: np.zeros(3)
        self.vacuum: Callable[[np.ndarray], bool] = lambda tip: False
        self.vacuum_lost = False
        self.wrench_known = True
        self.follows = True
        self.issued: list[tuple[float, JointState, JointTrajectory]] = []
        self.fractions: list[float] = []
        self.tips: list[np.ndarray] = []

    @property
    def tip(self) -> np.ndarray:
        return self.robot.tip(self.state.position).position

    def observe(self) -> RobotObservation:
        tip = self.tip
        wrench = np.concatenate([self.force(tip), np.zeros(3)]) if self.wrench_known else None
        return RobotObservation(
            self.time,
            self.state.position.copy(),
            self.state.velocity.copy(),
            wrench,
            self.vacuum(tip),
            self.vacuum_lost,
        )

    def take(self, trajectory: JointTrajectory) -> None:
        self.issued.append((self.time, self.state, trajectory))

    def advance(self) -> None:
        self.time += self.period
        if self.issued and self.follows:
            since, entered, trajectory = self.issued[-1]
            self.state = state_at(trajectory, entered, self.time - since)
        self.tips.append(self.tip)

    def finish(self, executor: MotionExecutor, limit: float = 30.0) -> MotionResult:
        """Tick until the running motion ends; fails if it does not within `limit` seconds."""
        end = self.time + limit
        while self.time < end:
            update = executor.tick(self.observe())
            self.fractions.append(update.fraction)
            if update.trajectory is not None:
                self.take(update.trajectory)
            if update.result is not None:
                return update.result
            self.advance()
        raise AssertionError(f"the motion did not end within {limit} s")

    def run(self, executor: MotionExecutor, goal: MotionGoal, limit: float = 30.0) -> MotionResult:
        executor.start(goal, self.observe())
        return self.finish(executor, limit)


@pytest.fixture
def make_arm(robot: Kinematics) -> Callable[..., FakeArm]:
    def make(q: np.ndarray = START) -> FakeArm:
        return FakeArm(robot, np.array(q))

    return make


class PandaLab:
    """A robot on a bench, the backend before it, and a clock that only the loop moves."""

    def __init__(self, robot: Kinematics, limits: JointLimits, params: PandaParams) -> None:
        self.time = 100.0
        self.limits, self.names = limits, robot.joint_names
        self.robot = MockRobot()
        self.library = MockLibrary(self.robot, clock=lambda: self.time, sleep=self.sleep)
        self.arm = PandaArm(
            robot,
            limits,
            params,
            library=self.library,
            clock=lambda: self.time,
            sleep=self.sleep,
            threaded=False,
        )

    def sleep(self, seconds: float) -> None:
        self.time += seconds

    def feed(self, seconds: float) -> None:
        end = self.time + seconds
        while self.time < end and self.arm.feed():
            pass

    def move(self, joint: int = 0, by: float = 0.2) -> JointTrajectory:
        goal = self.robot.q.copy()
        goal[joint] += by
        return joint_move(self.names, JointState.at_rest(self.robot.q), goal, self.limits)


@pytest.fixture
def make_lab(robot: Kinematics, limits: JointLimits) -> Callable[..., PandaLab]:
    def make(**params: Any) -> PandaLab:
        lab = PandaLab(robot, limits, PandaParams(**({"robot_ip": "172.16.0.2"} | params)))
        lab.robot.wrench = np.array([0.1, 0, 0, 0, 0, 0])
        return lab

    return make


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest):
    """A context and an executor in the module's DOMAIN; all is spun from the test's thread."""
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.parameter import Parameter

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = Context()
    rclpy.init(context=context, domain_id=request.module.DOMAIN)
    executor = SingleThreadedExecutor(context=context)

    class Ros:
        def __init__(self) -> None:
            self.nodes: list[Any] = []

        def add(self, cls: Any, *args: Any, **overrides: Any) -> Any:
            parameters = [Parameter(k.replace("__", "."), value=v) for k, v in overrides.items()]
            node = cls(*args, context=context, parameter_overrides=parameters)
            executor.add_node(node)
            self.nodes.append(node)
            return node

        def remove(self, node: Any) -> None:
            self.nodes.remove(node)
            executor.remove_node(node)
            node.destroy_node()

        def spin(self, timeout: float = 0.005) -> None:
            executor.spin_once(timeout_sec=timeout)

        def until(self, condition: Callable[[], bool], what: str, seconds: float = 30.0) -> None:
            deadline = time.monotonic() + seconds
            while not condition():
                assert time.monotonic() < deadline, f"{what} did not come in {seconds} s"
                executor.spin_once(timeout_sec=0.005)

        def ask(self, client: Any, request: Any) -> Any:
            self.until(client.service_is_ready, "the service")
            answer = client.call_async(request)
            self.until(answer.done, "the answer")
            return answer.result()

        def send(self, client: Any, goal: Any) -> Any:
            """Send an action goal and return the future of its result."""
            self.until(client.server_is_ready, "the action server")
            sent = client.send_goal_async(goal)
            self.until(sent.done, "the goal's acceptance")
            return sent.result(), sent.result().get_result_async()

        def result(self, future: Any, seconds: float = 60.0) -> Any:
            self.until(future.done, "the result", seconds)
            return future.result().result.result

    harness = Ros()
    yield harness
    for node in list(harness.nodes):
        harness.remove(node)
    executor.shutdown()
    rclpy.shutdown(context=context)
