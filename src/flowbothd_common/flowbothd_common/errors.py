"""The errors of the project; a message says what failed, what was given, what is allowed."""

from __future__ import annotations


class FlowBotError(Exception):
    """Base of all errors that a user can meet.

    Args:
        what: What failed.
        got: What was given, if that explains it.
        allowed: What would have been accepted.
        hint: What to do next.

    The parts stay available as attributes of the same names.
    """

    def __init__(
        self, what: str, *, got: object = None, allowed: object = None, hint: str | None = None
    ) -> None:
        self.what = what
        self.got = got
        self.allowed = allowed
        self.hint = hint
        parts = [what]
        if got is not None:
            parts.append(f"got {got}")
        if allowed is not None:
            parts.append(f"allowed: {allowed}")
        if hint is not None:
            parts.append(hint)
        super().__init__("; ".join(parts))


class InvalidCloudError(FlowBotError):
    """A point cloud is empty, not finite, or has the wrong shape or fields."""


class InvalidMessageError(FlowBotError, ValueError):
    """A message is incomplete, not finite, of another size, order or frame, or stamped wrongly.

    Such a message counts as not received.
    """


class FrameUnavailableError(FlowBotError):
    """A transform is missing, or a message is in an unknown frame."""


class CheckpointError(FlowBotError):
    """A file of weights is missing, damaged, or not ours."""


class MotionRejectedError(FlowBotError):
    """A motion goal is malformed, or cannot be accepted now."""


class SuctionError(FlowBotError):
    """The pump did not carry out a command."""


class ParameterError(FlowBotError, ValueError):
    """A parameter has the wrong type or lies outside its range."""


class ObjectModelError(FlowBotError):
    """An object to manipulate is unknown, incomplete or cannot be loaded."""
