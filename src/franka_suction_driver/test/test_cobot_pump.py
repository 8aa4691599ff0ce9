"""The Cobot Pump behind libfranka's VacuumGripper, with the traps that facts tell of."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

from flowbothd_common.errors import SuctionError
from flowbothd_common.types import SuctionReading
from franka_suction_driver.backend_params import PumpNodeParams
from franka_suction_driver.backends.cobot_pump import CobotPump, setpoint
from franka_suction_driver.backends.mock import DeviceStatus, MockLibrary, MockRobot
from franka_suction_driver.backends.protocol import BackendError

PARAMS = PumpNodeParams(robot_ip="172.16.0.2", poll_rate=100.0, vacuum_timeout=20.0)


class Bench:
    def __init__(self, params: PumpNodeParams = PARAMS) -> None:
        self.time = 0.0
        self.robot = MockRobot()
        self.pump = CobotPump(params, library=MockLibrary(self.robot), clock=lambda: self.time)
        self.pump.connect()

    def reads(self, condition: Callable[[SuctionReading], bool], what: str) -> SuctionReading:
        found: list[SuctionReading] = []

        def met() -> bool:
            reading = self.pump.reading()
            if reading is not None and condition(reading):
                found.append(reading)
            return bool(found)

        until(met, what)
        return found[0]


def until(condition: Callable[[], bool], what: str, seconds: float = 10.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"{what} did not come in {seconds} s"
        time.sleep(0.002)


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.pump.close()


def test_pascal_become_units_of_ten_millibar_and_back(bench: Bench) -> None:
    """The trap: the set-point is a byte in 10 mbar, the state is in mbar.

    Examples that pass 3 or 100 set 30 or 1000 mbar; 60000 Pa are 600 mbar are 60.
    """
    bench.robot.pump.sealed = True
    bench.pump.command(60000.0)
    until(lambda: "vacuum" in bench.robot.names(), "the command")
    arguments = dict(bench.robot.calls)["vacuum"]
    assert arguments[0] == 60
    assert isinstance(arguments[0], int)
    reading = bench.reads(lambda r: r.part_present, "the part")
    assert reading.vacuum == 60000.0


def test_set_points_that_could_never_hold_a_part_are_refused(bench: Bench) -> None:
    """The trap: below the pump's H2 part_present is never true: it holds, and nobody knows."""
    with pytest.raises(SuctionError, match="part-present threshold"):
        bench.pump.command(30000.0)
    with pytest.raises(SuctionError, match="pascal"):
        bench.pump.command(600.0 * 1000)
    assert "vacuum" not in bench.robot.names()
    assert setpoint(60000.0, 55000.0) == 60


def test_reading_goes_on_while_vacuum_blocks(bench: Bench) -> None:
    """The trap: vacuum() blocks until its timeout; a node that called it would stand still."""
    bench.robot.pump.hold = threading.Event()
    began = time.monotonic()
    bench.pump.command(60000.0)
    until(lambda: "vacuum" in bench.robot.names(), "the command")
    assert time.monotonic() - began < 5.0
    bench.robot.pump.sealed = True
    bench.reads(lambda r: r.part_present, "the part, while the call still blocks")
    assert not bench.robot.pump.hold.is_set()
    bench.robot.pump.hold.set()


def test_a_lost_part_is_told(bench: Bench) -> None:
    """The trap: vacuum() returns once; what happens afterwards only polling can tell."""
    bench.robot.pump.sealed = True
    bench.pump.command(60000.0)
    bench.reads(lambda r: r.part_present, "the part")
    bench.robot.pump.sealed = False
    lost = bench.reads(lambda r: r.part_detached, "the loss")
    assert not lost.part_present


def test_a_release_is_verified_and_the_command_ended(bench: Bench) -> None:
    bench.robot.pump.sealed = True
    bench.pump.command(60000.0)
    bench.reads(lambda r: r.part_present, "the part")
    bench.pump.command(0.0)
    bench.reads(lambda r: not r.part_present, "the release")
    until(lambda: bench.robot.names()[-2:] == ["drop_off", "stop"], "the stop after the release")
    assert bench.reads(lambda r: r.vacuum == 0.0, "no vacuum").fault == ""


def test_a_part_that_stays_is_a_fault(bench: Bench) -> None:
    """The trap: leaving while the part is still attached pulls with all of its load."""
    bench.pump.command(60000.0)
    bench.robot.pump.stuck = True
    bench.pump.command(0.0)
    fault = bench.reads(lambda r: bool(r.fault), "the fault").fault
    assert "not released: 30000 Pa" in fault


def test_repeating_a_command_does_not_restart_it(bench: Bench) -> None:
    for _ in range(5):
        bench.pump.command(60000.0)
    until(lambda: "vacuum" in bench.robot.names(), "the command")
    bench.pump.command(60000.0)
    bench.pump.close()
    assert bench.robot.names().count("vacuum") == 1


def test_silence_of_whoever_commands_switches_the_pump_off(bench: Bench) -> None:
    bench.robot.pump.sealed = True
    bench.pump.command(60000.0)
    bench.reads(lambda r: r.part_present, "the part")
    bench.time += 10.0
    fault = bench.reads(lambda r: bool(r.fault), "the fault").fault
    assert "fell silent" in fault
    until(lambda: "drop_off" in bench.robot.names(), "the release")
    bench.pump.command(60000.0)
    bench.reads(lambda r: r.part_present and not r.fault, "life after silence")


def test_a_lost_link_is_a_fault_and_stop_is_called_nevertheless(bench: Bench) -> None:
    """The trap: vacuum() and drop_off() raise on a lost link; without stop() the pump runs on."""
    bench.pump.command(60000.0)
    until(lambda: "vacuum" in bench.robot.names(), "the command")
    bench.robot.pump.lost = RuntimeError("libfranka: UDP receive: timeout")
    assert "does not answer" in bench.reads(lambda r: bool(r.fault), "the fault").fault
    bench.pump.close()
    assert bench.robot.names()[-2:] == ["drop_off", "stop"]


def test_a_pump_whose_cable_is_back_obeys_again(bench: Bench) -> None:
    """A pulled cable left the pump dead until pump_node was restarted, with the part at the cup."""
    bench.robot.pump.sealed = True
    bench.pump.command(60000.0)
    bench.reads(lambda r: r.part_present, "the part")
    bench.robot.unplug()
    bench.reads(lambda r: "does not answer" in r.fault, "the loss")
    bench.robot.plug_in()
    bench.time += 10.0

    def commanded_and_held() -> bool:
        # suction_node repeats its command; what became of an earlier one nobody knows.
        bench.pump.command(60000.0)
        reading = bench.pump.reading()
        return reading is not None and reading.part_present and not reading.fault

    until(commanded_and_held, "the part, held again")
    bench.robot.calls.clear()
    bench.pump.command(0.0)
    until(lambda: bench.robot.names() == ["drop_off", "stop"], "the release")
    assert not bench.reads(lambda r: not r.part_present, "no part").fault


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "no number"])
def test_a_vacuum_that_is_no_number_is_no_reading(bench: Bench, value: Any) -> None:
    """NaN is not above the threshold of a held part, and not below that of a release either."""
    bench.robot.pump.sealed = True
    bench.pump.command(60000.0)
    bench.reads(lambda r: r.part_present, "the part")
    bench.robot.pump.reported = value
    reading = bench.reads(lambda r: bool(r.fault), "the fault")
    assert reading.vacuum == 0.0
    assert not reading.part_present
    bench.pump.command(0.0)
    until(lambda: bench.robot.names()[-1] == "stop", "the stop after the release")
    bench.robot.pump.reported = None
    fault = bench.reads(lambda r: "is not released" in r.fault or "release" in r.fault, "the doubt")
    assert not fault.part_present


@pytest.mark.parametrize("vacuum", [float("nan"), float("inf"), float("-inf")])
def test_a_command_that_is_no_number_is_refused(bench: Bench, vacuum: float) -> None:
    """A command of NaN counted as a release, and one of infinity ended pump_node."""
    bench.robot.pump.sealed = True
    bench.pump.command(60000.0)
    bench.reads(lambda r: r.part_present, "the part")
    with pytest.raises(SuctionError, match="set-point"):
        bench.pump.command(vacuum)
    assert "drop_off" not in bench.robot.names()


def test_every_exit_switches_the_pump_off(bench: Bench) -> None:
    bench.robot.pump.sealed = True
    bench.pump.command(60000.0)
    bench.reads(lambda r: r.part_present, "the part")
    bench.pump.close()
    bench.pump.close()
    assert bench.robot.names()[-2:] == ["drop_off", "stop"]
    assert bench.robot.pump.setpoint_mbar == 0
    assert not [t for t in threading.enumerate() if t.name.startswith("pump_")]


def test_a_red_light_is_a_fault(bench: Bench) -> None:
    bench.robot.pump.status = DeviceStatus.kRed
    assert "device error" in bench.reads(lambda r: bool(r.fault), "the fault").fault


def test_a_pump_that_is_not_configured_names_desk() -> None:
    """The trap: without Cobot Pump chosen in Desk the connection fails with a network error."""
    robot = MockRobot()
    robot.refusal = RuntimeError("libfranka gripper: Connection error")
    pump = CobotPump(PARAMS, library=MockLibrary(robot))
    with pytest.raises(BackendError, match="Cobot Pump"):
        pump.connect()
    with pytest.raises(BackendError, match="robot_ip"):
        CobotPump(replace(PARAMS, robot_ip=""), library=MockLibrary(robot)).connect()
