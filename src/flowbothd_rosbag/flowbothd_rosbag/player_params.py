"""What is played, and how."""

from __future__ import annotations

from dataclasses import dataclass

from flowbothd_common.parameters import parameter


@dataclass(frozen=True)
class PlayerParams:
    """Parameters of the player node."""

    bag: str = parameter("", "folder or file of the recording")
    rate: float = parameter(1.0, "speed, in bag seconds per second", minimum=0.01, maximum=100.0)
    begin: float = parameter(0.0, "where to begin, after the first message [s]", minimum=0.0)
    end: float = parameter(0.0, "where to end, after the first message [s]; 0 = at its end")
    loop: bool = parameter(False, "begin anew at the end")
    exclude: str = parameter("", "topics that match this regular expression are not played")
    wait_for: tuple[str, ...] = parameter((), "topics that must have a subscriber before it begins")
    wait_timeout: float = parameter(60.0, "longest wait for subscribers [s]", minimum=0.0)
    delay: float = parameter(
        1.0, "time for subscribers to find the publishers [s]", minimum=0.0, maximum=60.0
    )
