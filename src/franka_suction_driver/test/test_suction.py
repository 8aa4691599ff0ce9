"""The suction cycle: every phase by every event, and the pump that says nothing."""

from __future__ import annotations

import pytest

from flowbothd_common.errors import SuctionError
from flowbothd_common.types import SuctionPhase, SuctionReading
from franka_suction_driver.suction.suction import SuctionMachine
from franka_suction_driver.suction_params import SuctionParams

EMPTY = SuctionReading(1000.0)
HELD = SuctionReading(60000.0, part_present=True)
DETACHED = SuctionReading(2000.0, part_detached=True)


def machine(*events: float | SuctionReading) -> SuctionMachine:
    """A machine after events at time 0: numbers are commands, readings are measurements."""
    made = SuctionMachine(SuctionParams(), 0.0)
    for event in events:
        if isinstance(event, SuctionReading):
            made.measure(event, 0.0)
        else:
            made.command(event, 0.0)
    return made


@pytest.mark.parametrize(
    ("events", "phase"),
    [
        ((), SuctionPhase.OFF),
        ((EMPTY,), SuctionPhase.OFF),
        ((HELD,), SuctionPhase.OFF),
        ((6e4,), SuctionPhase.BUILDING),
        ((6e4, EMPTY), SuctionPhase.BUILDING),
        ((6e4, HELD), SuctionPhase.HOLDING),
        ((6e4, HELD, EMPTY), SuctionPhase.LOST),
        ((6e4, HELD, DETACHED), SuctionPhase.LOST),
        ((6e4, DETACHED), SuctionPhase.LOST),
        ((6e4, HELD, EMPTY, HELD), SuctionPhase.LOST),
        ((6e4, HELD, EMPTY, 0.0), SuctionPhase.OFF),
        ((6e4, HELD, EMPTY, 0.0, EMPTY, 6e4), SuctionPhase.BUILDING),
        ((6e4, HELD, EMPTY, 0.0, EMPTY, 6e4, HELD), SuctionPhase.HOLDING),
        ((6e4, HELD, 5e4), SuctionPhase.HOLDING),
        ((6e4, HELD, EMPTY, 5e4), SuctionPhase.LOST),
        ((6e4, HELD, 0.0), SuctionPhase.OFF),
        ((6e4, SuctionReading(fault="valve")), SuctionPhase.FAULT),
    ],
)
def test_phases(events: tuple[float | SuctionReading, ...], phase: SuctionPhase) -> None:
    assert machine(*events).status(0.1).phase is phase


def test_a_silent_pump_is_a_fault_until_it_speaks() -> None:
    made = machine(6e4, HELD)
    assert made.status(0.4).phase is SuctionPhase.HOLDING
    silent = made.status(2.0)
    assert silent.phase is SuctionPhase.FAULT
    assert "no measurement from the pump for 2.0 s" in silent.message
    made.measure(HELD, 2.0)
    assert made.status(2.1).phase is SuctionPhase.HOLDING


def test_a_pump_that_never_spoke_is_told_apart() -> None:
    assert "since the start" in machine().status(1.0).message


def test_a_part_that_is_not_released_is_a_fault() -> None:
    """Retreating with a part still on the cup pulls on it: this must not look like off."""
    made = machine(6e4, HELD, 0.0)
    made.measure(HELD, 1.9)
    assert made.status(1.9).phase is SuctionPhase.OFF
    made.measure(HELD, 2.2)
    stuck = made.status(2.2)
    assert stuck.phase is SuctionPhase.FAULT
    assert "not released" in stuck.message
    made.measure(EMPTY, 2.3)
    assert made.status(2.3).phase is SuctionPhase.OFF


@pytest.mark.parametrize("vacuum", [-1.0, 1e6, float("nan"), float("inf")])
def test_impossible_vacuum_is_refused_and_changes_nothing(vacuum: float) -> None:
    made = machine(6e4, HELD)
    with pytest.raises(SuctionError, match=r"0 \.\. 80000 Pa.*pascal"):
        made.command(vacuum, 0.0)
    assert made.status(0.1).phase is SuctionPhase.HOLDING
    assert made.status(0.1).vacuum == 6e4
