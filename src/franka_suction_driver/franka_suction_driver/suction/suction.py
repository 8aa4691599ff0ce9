"""State of one suction cycle, judged from what the pump measures and when it last spoke."""

from __future__ import annotations

from dataclasses import dataclass

from flowbothd_common.errors import SuctionError
from flowbothd_common.types import SuctionPhase, SuctionReading
from franka_suction_driver.suction_params import SuctionParams


@dataclass(frozen=True)
class SuctionStatus:
    """The judgement.

    Attributes:
        phase: Off, building, holding, lost or fault.
        vacuum: What the pump is told to hold below ambient, 0 = off [Pa].
        reading: The last measurement.
        message: For people; empty if all is well.
    """

    phase: SuctionPhase
    vacuum: float
    reading: SuctionReading
    message: str = ""


class SuctionMachine:
    """Follows the pump through suction cycles.

    A cycle begins when vacuum is commanded and ends when it is switched off. What was lost in a
    cycle stays lost until the next one. A pump that is silent for longer than the timeout is a
    fault for as long as it is silent.

    Args:
        params: Limits and timeouts.
        now: Steady clock [s]; the first measurement is awaited from here.
    """

    def __init__(self, params: SuctionParams, now: float) -> None:
        self._params = params
        self._phase = SuctionPhase.OFF
        self._vacuum = 0.0
        self._reading = SuctionReading()
        self._heard = now
        self._ever_heard = False
        self._commanded = now
        self._held = False

    def command(self, vacuum: float, now: float) -> None:
        """Set the vacuum [Pa below ambient]; 0 releases the part and switches off.

        Raises:
            SuctionError: negative, not finite, or more than the pump can do.
        """
        if not 0.0 <= vacuum <= self._params.max_vacuum:
            raise SuctionError(
                "vacuum set-point",
                got=f"{vacuum:g} Pa",
                allowed=f"0 .. {self._params.max_vacuum:g} Pa below ambient",
                hint="the unit is pascal: 600 mbar are 60000 Pa",
            )
        begins = vacuum > 0 and self._vacuum == 0
        self._vacuum = vacuum
        if vacuum == 0:
            self._phase = SuctionPhase.OFF
            self._commanded = now
        elif begins:
            self._phase = SuctionPhase.BUILDING
            self._held = False
            self._commanded = now

    def measure(self, reading: SuctionReading, now: float) -> None:
        """Take in a measurement, received at `now` on the steady clock."""
        self._reading = reading
        self._heard = now
        self._ever_heard = True
        if self._vacuum == 0:
            self._phase = SuctionPhase.OFF
            return
        if self._phase is SuctionPhase.LOST:
            return
        if reading.part_detached or (self._held and not reading.part_present):
            self._phase = SuctionPhase.LOST
        elif reading.part_present:
            self._phase = SuctionPhase.HOLDING
            self._held = True
        else:
            self._phase = SuctionPhase.BUILDING

    def status(self, now: float) -> SuctionStatus:
        """The judgement at `now` on the steady clock."""
        problem = self._problem(now)
        if problem:
            return SuctionStatus(SuctionPhase.FAULT, self._vacuum, self._reading, problem)
        message = ""
        if self._phase is SuctionPhase.LOST:
            message = "the part came off; switch the suction off and probe again"
        return SuctionStatus(self._phase, self._vacuum, self._reading, message)

    def _problem(self, now: float) -> str:
        params = self._params
        silent = now - self._heard
        if not silent <= params.measurement_timeout:
            since = f"for {silent:.1f} s" if self._ever_heard else "since the start"
            return f"no measurement from the pump {since}; is the bridge or the backend running?"
        if self._reading.fault:
            return f"pump fault: {self._reading.fault}"
        releasing = self._vacuum == 0 and self._ever_heard
        # Written so that a vacuum that is not finite counts as held.
        vented = self._reading.vacuum <= params.release_pressure
        held = self._reading.part_present or not vented
        if releasing and held and now - self._commanded > params.release_timeout:
            return (
                f"the part is not released {now - self._commanded:.1f} s after switching off "
                f"({self._reading.vacuum:.0f} Pa left); do not retreat with it"
            )
        return ""
