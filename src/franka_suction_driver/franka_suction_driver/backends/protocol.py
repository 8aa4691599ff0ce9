"""The one face that every arm and every pump shows to the nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from flowbothd_common.errors import FlowBotError
from flowbothd_common.motion import JointTrajectory
from flowbothd_common.types import Array, SuctionReading

NOTHING_TO_RECOVER = "nothing to recover from"


class BackendError(FlowBotError):
    """The robot or the pump cannot be reached, or refuses; the message says what to do."""


@dataclass(frozen=True)
class ArmState:
    """What is known of the arm at one instant.

    Attributes:
        positions: (J,) measured [rad].
        velocities: (J,) measured [rad/s].
        wrench: (6,) force [N] and torque [Nm] that the environment exerts on the tool, at the
            suction tip, in base axes; None where it cannot be known, which is not the same as 0.
        fault: Empty, or why the arm does not move, and what to do about it.
        tip: (3,) where the robot itself thinks that its end effector is, in base [m]; or None.
        fresh: These are new measurements. Old ones are kept for the sake of the fault, and must not
            be published again as if the arm had just been measured.
    """

    positions: Array
    velocities: Array
    wrench: Array | None = None
    fault: str = ""
    tip: Array | None = None
    fresh: bool = True


class ArmBackend(Protocol):
    """Follows trajectories; every method returns at once, but for `connect`, `recover`, `close`.

    A fault stays until `recover` is called: nothing recovers by itself.
    """

    def connect(self) -> None:
        """Reach the robot and hold it where it stands.

        A robot that is reached but cannot be moved as it is (in a reflex, stopped by the user,
        guided by hand) is connected all the same: its states are read, and why it does not move is
        their fault.

        Raises:
            BackendError: it cannot be reached; the remedy is in the message.
        """
        ...

    def state(self) -> ArmState | None:
        """Newest state; None before the first."""
        ...

    def follow(self, trajectory: JointTrajectory) -> str:
        """Take over a trajectory now; empty, or why it is refused: the arm then brakes.

        Whoever sends what does not fit has lost track of the arm.
        """
        ...

    def hold(self) -> None:
        """Brake within the limits and stay."""
        ...

    def recover(self) -> str:
        """Clear a fault on somebody's explicit request; empty, or why it stays.

        Without a fault it answers NOTHING_TO_RECOVER and touches nothing: the arm may be moving.
        """
        ...

    def tare(self) -> str:
        """Take the present wrench for zero; empty, or why not."""
        ...

    def close(self) -> None:
        """Stop and disconnect; safe to be called at any time, more than once."""
        ...


class PumpBackend(Protocol):
    """Runs the pump; no method but `connect` and `close` waits for it."""

    def connect(self) -> None:
        """Reach the pump.

        Raises:
            BackendError: it cannot be reached; the remedy is in the message.
        """
        ...

    def command(self, vacuum: float) -> None:
        """Hold `vacuum` [Pa below ambient] from now on; 0 = release the part and switch off.

        Raises:
            SuctionError: the pump cannot do that, or would never report a part.
        """
        ...

    def reading(self) -> SuctionReading | None:
        """Newest measurement; None before the first."""
        ...

    def close(self) -> None:
        """Release, switch off and disconnect; safe to be called at any time, more than once."""
        ...
