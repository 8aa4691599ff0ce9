"""Frames that wait for the joint states of their time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Generic, TypeVar

from flowbothd_common.types import Array
from flowbothd_perception.joint_buffer import JointBuffer

F = TypeVar("F")


class WaitingFrames(Generic[F]):
    """Frames in order of arrival, each until its joint positions are known or its time is up.

    Args:
        patience: How long a frame waits [s].
        most: How many wait; a further one drives out the oldest.
    """

    def __init__(self, patience: float, most: int = 4) -> None:
        self._patience, self._most = patience, most
        self._frames: list[tuple[float, float, F]] = []

    def add(self, stamp: float, frame: F, now: float) -> list[F]:
        """Let a frame wait; returns those that it drives out."""
        self._frames.append((stamp, now, frame))
        out, self._frames = self._frames[: -self._most], self._frames[-self._most :]
        return [frame for _, _, frame in out]

    def take(self, joints: JointBuffer, now: float) -> Iterator[tuple[F, float, Array | None, str]]:
        """Yield frames that wait no longer: frame, arrival, joint positions or None, and why."""
        while self._frames:
            stamp, arrived, frame = self._frames[0]
            if not joints.reaches(stamp) and now - arrived < self._patience:
                return
            del self._frames[0]
            yield (frame, arrived, *joints.at(stamp))
