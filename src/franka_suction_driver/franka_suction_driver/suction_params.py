"""Parameters of suction_node and its state machine."""

from __future__ import annotations

from dataclasses import dataclass

from flowbothd_common.parameters import parameter


@dataclass(frozen=True)
class SuctionParams:
    """Parameters of suction_node and its state machine."""

    max_vacuum: float = parameter(80000.0, "Largest vacuum that may be set [Pa]", minimum=1000.0)
    measurement_timeout: float = parameter(
        0.5, "Silence of the pump on the steady clock that counts as a fault [s]", minimum=0.05
    )
    release_pressure: float = parameter(
        5000.0, "Vacuum below which a part counts as released [Pa]", minimum=0.0
    )
    release_timeout: float = parameter(
        2.0, "How long a release may take before it is a fault [s]", minimum=0.1
    )
