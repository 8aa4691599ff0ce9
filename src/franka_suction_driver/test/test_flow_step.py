"""Giving way: slower where it must be, never faster than planned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flowbothd_common.motion import JointState
from franka_suction_driver.arm.kinematics import Kinematics
from franka_suction_driver.arm.limits import JointLimits, Violation
from franka_suction_driver.execution.cartesian_planner import CartesianPlanner, TimedTrajectory
from franka_suction_driver.execution.flow_step import FlowStep
from franka_suction_driver.execution.tool_reference import Bounds, Reference, ToolLine
from franka_suction_driver.params import FlowStepParams
from franka_suction_driver.planning.inverse_kinematics import solve

PUSHED = np.array([0.0, 12.0, 0.0])


class AlwaysTooFast(CartesianPlanner):
    """Finds a limit broken by whatever replaces the plan, and remembers how fast that was."""

    def __init__(self, robot: Kinematics, limits: JointLimits) -> None:
        super().__init__(robot, limits, limits.box(0.05), 0.2)
        self.tried: list[float] = []

    def follow(self, reference: Reference, now: float, start: JointState) -> TimedTrajectory:
        times = np.linspace(now, reference.along_end, 200)
        self.tried.append(max(abs(float(reference.travel(t).velocity[0])) for t in times))
        found = super().follow(reference, now, start)
        return replace(found, excess=Violation(1.0, 2.0, "too fast", "acceleration"))


@pytest.mark.parametrize("slowing", [1.0, 0.3])
def test_a_replacement_is_never_faster_than_the_plan(
    robot: Kinematics, limits: JointLimits, make_arm, slowing: float
) -> None:
    """A step planned at 0.3 of the speed was "slowed down" to 0.5 of it, and could not give way."""
    box = limits.box(0.1)
    found = solve(
        robot,
        box,
        box.sample(np.random.default_rng(0), 256),
        np.array([0.55, -0.1, 0.5]),
        np.array([1.0, 0, 0]),
    )
    arm = make_arm(found[int(np.argmax(box.margin(found)))])
    params = FlowStepParams()
    planner = AlwaysTooFast(robot, limits)
    tip = robot.tip(arm.state.position)
    line = ToolLine(tip.position, np.array([-1.0, 0, 0]), 0.05, tip.axis, tip.axis, 0.0)
    bounds = Bounds(params.speed)
    reference = Reference.start(line, bounds.scaled(slowing), 0.05)
    planned = CartesianPlanner.follow(
        planner, reference, 0.0, JointState.at_rest(arm.state.position)
    )
    assert planned.trajectory is not None
    step = FlowStep(
        robot, planner, reference, replace(planned, slowing=slowing, excess=None), 0.05, params, 0
    )
    planner.tried.clear()
    arm.force, arm.vacuum = (lambda _: PUSHED), (lambda _: True)
    for _ in range(60):
        update = step.tick(arm.time, arm.state, arm.observe())
        if update.trajectory is not None:
            arm.take(update.trajectory)
        arm.advance()
    assert len(planner.tried) > 3
    assert max(planner.tried) <= slowing * params.speed * 1.001
    assert min(planner.tried) < 0.5 * slowing * params.speed
