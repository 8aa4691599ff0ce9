"""Which sign and frame the wrench has, found by a touch of the operator's hand.

Convention: the force that the environment exerts on the tool, in the axes of the robot's base. A
hand that presses the cup upwards gives a positive z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from flowbothd.doctor.doctor_checks import Check, Light
from flowbothd_common.types import Array

NAME = "wrench by touch"
ASK = "press the cup upwards with your hand, lightly (about 10 N), and let go again"
_LEAST_FORCE = 3.0
_LEAST_SAMPLES = 5
# A touch lasts; single samples beyond it are noise.
_SMOOTHING = 5
_CLEAR = 2.0


@dataclass(frozen=True)
class WrenchSample:
    """One message of external_wrench.

    Attributes:
        force: (3,) as it was sent; may hold anything [N].
        frame: Its frame_id.
    """

    force: Array
    frame: str


class Felt(StrEnum):
    """Measurements during a touch."""

    UP = "up"
    DOWN = "down"
    NOTHING = "nothing"
    SIDEWAYS = "sideways"
    UNCLEAR = "unclear"


@dataclass(frozen=True)
class Touch:
    """The judgement of a touch.

    Attributes:
        felt: Direction of the force along the base's z axis.
        force: Largest lasting change along it, with its sign [N].
        unusable: Number of samples that were not finite.
        frames: All frame_ids that came.
    """

    felt: Felt
    force: float = 0.0
    unusable: int = 0
    frames: tuple[str, ...] = ()


def feel(rest: Sequence[WrenchSample], touched: Sequence[WrenchSample]) -> Touch:
    """Find the direction of a touch in the samples before and during it.

    Samples that are not finite are left out and counted. A drift of the sensor does no harm: only
    the change against the rest counts, and only one that lasts for several samples.

    Args:
        rest: Samples without contact.
        touched: Samples while the operator was asked to press.
    """
    frames = tuple(dict.fromkeys(sample.frame for sample in [*rest, *touched]))
    before, during = _usable(rest), _usable(touched)
    unusable = len(rest) + len(touched) - len(before) - len(during)
    if min(len(before), len(during)) < _LEAST_SAMPLES:
        return Touch(Felt.NOTHING, unusable=unusable, frames=frames)
    change = _smoothed(during - np.median(before, axis=0))
    z = change[:, 2]
    peak = change[int(np.argmax(np.abs(z)))]
    force, aside = float(peak[2]), float(np.abs(change[:, :2]).max())
    opposite = float((-np.sign(force) * z).max())
    if not max(abs(force), aside) >= _LEAST_FORCE:
        felt = Felt.NOTHING
    elif aside > abs(force):
        felt = Felt.SIDEWAYS
    elif opposite >= _LEAST_FORCE and opposite * _CLEAR > abs(force):
        felt = Felt.UNCLEAR
    else:
        felt = Felt.UP if force > 0 else Felt.DOWN
    return Touch(felt, force, unusable, frames)


def judge_touch(touch: Touch, base_frame: str, sign: float) -> Check:
    """Judge whether a touch from below was felt as motion_node needs it.

    Args:
        touch: What was felt.
        base_frame: The frame that wrenches must have.
        sign: motion_node's parameter wrench.sign, by which every wrench is multiplied.
    """
    wrong = [frame for frame in touch.frames if frame != base_frame]
    if wrong:
        return Check(
            NAME,
            Light.RED,
            f"the wrench is in the frame {wrong[0] or '(empty)'!r}, needed is {base_frame!r}",
            f"let the driver publish it in the axes of {base_frame}: for franka_ros2 remap "
            "external_wrench to external_wrench_in_base_frame",
        )
    doubt = f" ({touch.unusable} samples were not finite)" if touch.unusable else ""
    if touch.felt in (Felt.NOTHING, Felt.SIDEWAYS, Felt.UNCLEAR):
        found = {
            Felt.NOTHING: f"no touch of {_LEAST_FORCE:g} N was felt",
            Felt.SIDEWAYS: "the touch went sideways",
            Felt.UNCLEAR: "the touch went up and down",
        }[touch.felt]
        light = Light.RED if touch.unusable else Light.YELLOW
        return Check(NAME, light, found + doubt, f"ask again with --touch, and {ASK}")
    seen = f"pressing upwards gave {touch.force:+.1f} N along z{doubt}"
    if touch.unusable:
        return Check(NAME, Light.RED, seen, "look for drop-outs in the sensor or its driver")
    if touch.force * sign > 0:
        return Check(NAME, Light.GREEN, f"{seen}, as it must be with wrench.sign {sign:+g}")
    return Check(
        NAME,
        Light.RED,
        f"{seen}: the wrong sign with wrench.sign {sign:+g}, contacts would be felt late",
        f"set motion_node's wrench.sign: {-sign:.1f}",
    )


def not_asked() -> Check:
    """Report that the touch was not requested."""
    return Check(NAME, Light.SKIPPED, "not asked for", "--touch asks for a touch and checks it")


def _usable(samples: Sequence[WrenchSample]) -> Array:
    forces = [np.asarray(sample.force, dtype=float) for sample in samples]
    kept = [force for force in forces if force.shape == (3,) and np.isfinite(force).all()]
    return np.array(kept).reshape(-1, 3)


def _smoothed(change: Array) -> Array:
    """(N, 3) running medians of a few samples, which single spikes do not move."""
    windows = np.lib.stride_tricks.sliding_window_view(change, _SMOOTHING, axis=0)
    return np.median(windows, axis=-1)
