"""A door without physics: geometry decides whether a cup seals and a pull moves the leaf."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from flowbothd_common.motion import MotionGoal, MotionKind, MotionReason, MotionResult
from flowbothd_common.transforms import rotation_about, rotation_between, transform, unit
from flowbothd_common.types import SuctionPhase
from flowbothd_policy.commands import (
    Decision,
    Finish,
    Move,
    Predict,
    SetSuction,
    StopMotion,
)
from flowbothd_policy.events import (
    CloudArrived,
    MotionFinished,
    PredictionArrived,
    Start,
    SuctionChanged,
)
from flowbothd_policy.params import PolicyParams
from flowbothd_policy.state import Phase, PolicyState
from flowbothd_policy.state_machine import advance
from sim_bridge.oracle import GroundTruthFlow, OracleParams, OraclePredictor

MODES = ("pull_left", "pull_right", "push_left", "push_right")
HOME = transform(translation=(0.3, 0.0, 0.6))


@dataclass
class Door:
    """The four-mode door, seen from -x; "left" is +y, "pull" is towards -x."""

    mode: str
    seed: int = 0
    angle: float = 0.0
    limit: float = np.radians(70)
    unreachable: tuple[str, ...] = ()
    centre: tuple[float, float] = (0.55, 0.0)
    width: float = 0.1683
    height: float = 0.435
    tool: np.ndarray = field(default_factory=lambda: HOME.copy())
    held: np.ndarray | None = None
    rng: np.random.Generator = field(init=False)

    def __post_init__(self):
        self.rng = np.random.default_rng(self.seed)

    @property
    def open_ratio(self):
        return self.angle / self.limit

    def hinge(self, mode):
        """Point and axis of a mode's hinge; the axis turns the leaf open."""
        side = 1.0 if mode.endswith("left") else -1.0
        sign = side if mode.startswith("pull") else -side
        point = np.array([self.centre[0], self.centre[1] + side * self.width / 2, 0.0])
        return point, np.array([0.0, 0.0, -sign])

    def leaf_pose(self):
        """(4, 4) that carries points of the closed leaf to where they are."""
        point, axis = self.hinge(self.mode)
        turn = rotation_about(axis, self.angle)
        return transform(turn, point - turn @ point)

    def observe(self):
        leaf = np.column_stack(
            [
                np.full(700, self.centre[0]),
                self.centre[1] + self.rng.uniform(-0.5, 0.5, 700) * self.width,
                0.02 + self.rng.uniform(0, self.height, 700),
            ]
        )
        pose = self.leaf_pose()
        leaf = leaf @ pose[:3, :3].T + pose[:3, 3]
        side = self.rng.choice([-1.0, 1.0], 500)
        frame = np.column_stack(
            [
                np.full(500, self.centre[0] - 0.034),
                self.centre[1] + side * (self.width / 2 + self.rng.uniform(0, 0.04, 500)),
                0.02 + self.rng.uniform(0, self.height, 500),
            ]
        )
        cloud = np.concatenate([leaf, frame]) + self.rng.normal(scale=0.001, size=(1200, 3))
        if self.held is not None:
            cloud = cloud[np.linalg.norm(cloud - self.tool[:3, 3], axis=1) > 0.06]
        return cloud.astype(np.float32)

    def truth(self, points):
        pose = self.leaf_pose()
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        half = self.width / 2 + 0.004
        on_leaf = (np.abs(local[:, 0] - self.centre[0]) < 0.012) & (
            np.abs(local[:, 1] - self.centre[1]) < half
        )
        names = (self.mode, *(mode for mode in MODES if mode != self.mode))
        flows = []
        for mode in names:
            point, axis = self.hinge(mode)
            flow = np.where(on_leaf[:, None], np.cross(axis, points - point), 0.0)
            flows.append(flow / np.linalg.norm(flow, axis=1).max())
        return GroundTruthFlow(np.asarray(flows, np.float32), names, self.open_ratio)

    def execute(self, goal: MotionGoal) -> MotionResult:
        start = self.tool.copy()
        reason, fraction, message = getattr(self, f"_{goal.kind.value}")(goal)
        return MotionResult(
            goal.kind,
            reason,
            message,
            fraction,
            start,
            self.tool.copy(),
            contact=self.held is not None,
            vacuum=self.held is not None,
        )

    def _approach(self, goal):
        kind = "push" if goal.direction[0] > 0.5 else "pull"
        if kind in self.unreachable:
            return MotionReason.UNREACHABLE, 0.0, "no joint configuration reaches behind the door"
        turn = rotation_between((0, 0, 1), -goal.direction)
        self.tool = transform(turn, goal.contact + 0.1 * goal.direction)
        return MotionReason.REACHED, 1.0, ""

    def _probe(self, goal):
        self.tool[:3, 3] += 0.1 * goal.direction
        pose = self.leaf_pose()
        local = (self.tool[:3, 3] - pose[:3, 3]) @ pose[:3, :3]
        inset = self.width / 2 - abs(local[1] - self.centre[1])
        facing = abs(unit(goal.direction) @ pose[:3, 0])
        if abs(local[0] - self.centre[0]) > 0.02:
            return MotionReason.NO_CONTACT, 1.0, ""
        if inset < 0.012 or facing < np.cos(np.radians(25)):
            return MotionReason.CONTACT, 0.9, "no seal"
        self.held = local
        return MotionReason.VACUUM, 0.9, ""

    def _flow_step(self, goal):
        if self.held is None:
            return MotionReason.SUCTION_LOST, 0.0, ""
        point, axis = self.hinge(self.mode)
        arm = self.tool[:3, 3] - point
        arm[2] = 0
        radius = float(np.linalg.norm(arm))
        along = float(unit(np.cross(axis, arm)) @ goal.direction)
        room = self.limit - self.angle
        distance = goal.distance or 0.05
        if along < 0.6 or radius < 0.04 or room < 1e-3:
            # Only the cup stretches.
            self.tool[:3, 3] += 0.012 * goal.direction
            return MotionReason.STALLED, 0.2, "pull without motion"
        swing = min(distance / radius, room)
        self.angle += swing
        pose = self.leaf_pose()
        self.tool[:3, 3] = pose[:3, :3] @ self.held + pose[:3, 3]
        if swing >= room:
            return MotionReason.STALLED, swing * radius / distance, "end of the joint"
        return MotionReason.REACHED, 1.0, ""

    def _retreat(self, goal):
        self.tool = HOME.copy()
        return MotionReason.REACHED, 1.0, ""


@dataclass
class Run:
    """A whole run of the policy against a door."""

    state: PolicyState
    decisions: list[Decision]
    finish: Finish
    goals: list[MotionGoal]
    events: list[tuple[object, float]]

    def count(self, decision):
        return sum(d.decision == decision for d in self.decisions)


def run_policy(door: Door, params: PolicyParams, oracle: OracleParams) -> Run:
    """Drive the policy to its end; raises if it does not end within 2000 events."""
    predictor = OraclePredictor(door.truth, oracle)
    state, now, queue = PolicyState(), 0.0, [Start()]
    decisions, goals, events = [], [], []
    for _ in range(2000):
        event = queue.pop(0)
        now += 0.1
        events.append((event, now))
        state, commands = advance(state, event, now, params)
        for command in commands:
            if isinstance(command, Decision):
                decisions.append(command)
            elif isinstance(command, Predict):
                flows = predictor.sample(
                    command.points, command.history, command.samples, seed=command.seed
                )
                queue.append(PredictionArrived(command.points, flows, command.stamp, "oracle"))
            elif isinstance(command, SetSuction):
                if command.vacuum == 0:
                    door.held = None
                phase = SuctionPhase.BUILDING if command.vacuum else SuctionPhase.OFF
                queue.append(SuctionChanged(phase))
            elif isinstance(command, Move):
                goals.append(command.goal)
                result = door.execute(command.goal)
                if command.goal.kind is MotionKind.PROBE and result.vacuum:
                    queue.append(SuctionChanged(SuctionPhase.HOLDING))
                queue.append(MotionFinished(result))
            elif isinstance(command, StopMotion):
                pytest.fail("nothing stops the arm in this world")
            elif isinstance(command, Finish):
                return Run(state, decisions, command, goals, events)
        if not queue and state.phase is Phase.OBSERVING:
            queue.append(CloudArrived(door.observe(), now + 0.05))
    raise AssertionError(f"the policy did not end; last: {decisions[-5:]}")


@pytest.fixture
def make_door():
    return Door


@pytest.fixture
def drive():
    return run_policy
