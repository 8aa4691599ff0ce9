"""Drives the pure policy through a stepped world."""

from __future__ import annotations

from collections import deque
from typing import Protocol

from flowbothd_common.motion import MotionGoal
from flowbothd_evaluation.run_record.record import PredictionSample, RunRecord, StateSample
from flowbothd_policy.commands import (
    Command,
    Decision,
    Finish,
    Move,
    Predict,
    SetSuction,
    StopMotion,
)
from flowbothd_policy.events import (
    CloudArrived,
    Event,
    MotionFinished,
    OperatorStop,
    PredictionArrived,
    Start,
    WaitExpired,
)
from flowbothd_policy.params import PolicyParams
from flowbothd_policy.predictor import FlowPredictor
from flowbothd_policy.state import Phase, PolicyState
from flowbothd_policy.state_machine import advance, waiting


class World(Protocol):
    """What a stepped world offers to the policy.

    `tick` advances it a little and returns what happened meanwhile; everything else takes no
    simulated time.
    """

    @property
    def time(self) -> float:
        """Simulated time [s]."""

    def tick(self) -> list[Event]:
        """Advance; motion results and suction changes that came about."""

    def observe(self) -> CloudArrived:
        """The object as it is seen now."""

    def move(self, goal: MotionGoal) -> list[Event]:
        """Begin a motion; its result, if it was refused or took no time."""

    def stop(self) -> None:
        """Bring the running motion to an end."""

    def set_suction(self, vacuum: float) -> list[Event]:
        """Command the pump [Pa]."""

    def state(self) -> StateSample:
        """The world for the record."""


class PolicyDriver:
    """One run of the policy in a stepped world.

    Args:
        world: Stepped world, reset.
        predictor: Samples flow fields.
        params: Of the policy.
        record: Is filled.
        stop_at: End the run as soon as the open ratio exceeds this, as the paper's evaluation
            does; None = only the policy ends it, as on a robot.
        max_time: Simulated seconds after which an unfinished run is stopped.
    """

    def __init__(
        self,
        world: World,
        predictor: FlowPredictor,
        params: PolicyParams,
        record: RunRecord,
        *,
        stop_at: float | None = None,
        max_time: float = 900.0,
    ) -> None:
        self._world, self._predictor, self._params = world, predictor, params
        self._record, self._stop_at, self._max_time = record, stop_at, max_time
        self._state = PolicyState()
        self._events: deque[Event] = deque([Start()])
        self._waiting_since = 0.0

    def run(self) -> RunRecord:
        """Run to the policy's outcome and return the record."""
        self._record.states.append(self._world.state())
        while not self._finished():
            if not self._events:
                self._tick()
            while self._events and not self._finished():
                self._handle(self._events.popleft())
        self._record.states.append(self._world.state())
        return self._record

    def _finished(self) -> bool:
        return self._state.phase is Phase.FINISHED

    def _tick(self) -> None:
        if self._state.phase is Phase.OBSERVING and self._world.time > self._state.observe_after:
            self._events.append(self._world.observe())
            # Should the cloud not do, time has to pass before the next one.
            self._events.extend(self._world.tick())
            self._expire()
            return
        self._events.extend(self._world.tick())
        sample = self._world.state()
        if sample.time - self._record.states[-1].time >= 0.1:
            self._record.states.append(sample)
        if self._stop_at is not None and sample.open_ratio > self._stop_at:
            self._events.append(OperatorStop("the part is open", opened=True))
        elif sample.time > self._max_time:
            self._events.append(OperatorStop(f"no end after {self._max_time:g} s", opened=False))
        self._expire()

    def _expire(self) -> None:
        wait = waiting(self._state, self._params)
        if wait is not None and self._world.time - self._waiting_since > wait[1]:
            self._events.append(WaitExpired())
            self._waiting_since = self._world.time

    def _handle(self, event: Event) -> None:
        if isinstance(event, MotionFinished):
            # What the policy now decides is dated with this state, not with one before the motion.
            self._record.states.append(self._world.state())
        before = waiting(self._state, self._params)
        self._state, commands = advance(self._state, event, self._world.time, self._params)
        if commands or waiting(self._state, self._params) != before:
            self._waiting_since = self._world.time
        for command in commands:
            self._carry_out(command)

    def _carry_out(self, command: Command) -> None:
        if isinstance(command, Decision):
            self._record.decisions.append(command)
        elif isinstance(command, Predict):
            flows = self._predictor.sample(
                command.points, command.history, command.samples, seed=command.seed
            )
            self._record.predictions.append(PredictionSample(command.stamp, command.points, flows))
            model = self._predictor.model_id
            self._events.append(PredictionArrived(command.points, flows, command.stamp, model))
        elif isinstance(command, Move):
            self._events.extend(self._world.move(command.goal))
        elif isinstance(command, SetSuction):
            self._events.extend(self._world.set_suction(command.vacuum))
        elif isinstance(command, StopMotion):
            self._world.stop()
        elif not isinstance(command, Finish):
            raise TypeError(f"unknown command {command!r}")
