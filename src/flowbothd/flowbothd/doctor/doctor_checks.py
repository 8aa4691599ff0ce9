"""Checks of the doctor: green, yellow or red, with the remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from flowbothd_common.parameter_files import Parameters
from flowbothd_common.types import Array

_LATEST_STAMP = 0.5
_SAME_POINT = 0.005


class Light(StrEnum):
    """Severity of a finding."""

    GREEN = "green"
    YELLOW = "yellow"
    RED = "red"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class Check:
    """One line of the doctor's list.

    Attributes:
        name: What was looked at.
        light: Green: well; yellow: works, but; red: will not work; skipped: was not looked at.
        found: What was found.
        remedy: What to do; empty for green.
    """

    name: str
    light: Light
    found: str
    remedy: str = ""


@dataclass
class Heard:
    """Messages received on one topic while listening.

    Attributes:
        times: When each message came, on the steady clock [s].
        delays: Receiver's clock less the message's stamp [s].
    """

    times: list[float] = field(default_factory=list)
    delays: list[float] = field(default_factory=list)

    @property
    def rate(self) -> float:
        """Messages per second; 0 for fewer than two."""
        if len(self.times) < 2:
            return 0.0
        return (len(self.times) - 1) / max(1e-9, self.times[-1] - self.times[0])


def judge_rate(name: str, heard: Heard, least: float, remedy: str) -> Check:
    """Check the rate of a topic."""
    if not heard.times:
        return Check(name, Light.RED, "nothing came", remedy)
    light = Light.GREEN if heard.rate >= least else Light.YELLOW
    return Check(
        name,
        light,
        f"{heard.rate:.1f} Hz, wanted at least {least:g} Hz",
        "" if light is Light.GREEN else remedy,
    )


def judge_stamps(name: str, heard: Heard) -> Check:
    """Check that stamps are on this computer's clock."""
    if not heard.delays:
        return Check(name, Light.RED, "no stamps", "start the driver")
    delay = float(np.median(heard.delays))
    if -0.05 <= delay <= _LATEST_STAMP:
        return Check(name, Light.GREEN, f"{1e3 * delay:.0f} ms old")
    return Check(
        name,
        Light.RED,
        f"{delay:.2f} s old",
        "stamps must be of the clock that joint states have: synchronise the computers (chrony)",
    )


def judge_calibration(parameters: Parameters, missing: Sequence[str]) -> Check:
    """Check that required parameters are given and plausible."""
    if missing:
        return Check(
            "parameters of the lab",
            Light.RED,
            f"missing: {', '.join(missing)}",
            "write them into a file and give it with --params (docs/tutorials/own_robot.md)",
        )
    quaternion = np.array(parameters["perception_node"]["camera.quaternion"], dtype=float)
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1) > 1e-2:
        return Check(
            "parameters of the lab",
            Light.RED,
            f"camera.quaternion has length {length:.3f}",
            "give a unit quaternion x, y, z, w: calibrate again",
        )
    position = np.round(parameters["perception_node"]["camera.position"], 3).tolist()
    return Check("parameters of the lab", Light.GREEN, f"camera at {position} m")


def judge_end_effector(ours: Array | None, robots: Array | None) -> Check:
    """Our forward kinematics against the robot's own idea of its end effector.

    Args:
        ours: (3,) our tip [m], or None.
        robots: (3,) the robot's O_T_EE [m], or None.
    """
    name = "forward kinematics"
    if ours is None or robots is None:
        return Check(name, Light.YELLOW, "the robot's own pose did not come", "start arm_node")
    apart = float(np.linalg.norm(ours - robots))
    if apart <= _SAME_POINT:
        return Check(name, Light.GREEN, f"agrees within {1e3 * apart:.1f} mm")
    return Check(
        name,
        Light.RED,
        f"our tip and the robot's end effector are {1e3 * apart:.0f} mm apart",
        "set the end effector in Desk to the cup's tip (flange to tip 160 mm), mass and all; or "
        "give the description of your tool with robot.description_file",
    )


def judge_wrench(name: str, forces: Sequence[float]) -> Check:
    """Check that a force is measured, and small without contact."""
    if not forces:
        return Check(
            name,
            Light.RED,
            "no external_wrench",
            "move the arm away from a singularity (libfranka reports zeros there); remap the "
            "driver's wrench topic",
        )
    finite = np.isfinite(forces)
    if not finite.all():
        return Check(
            name,
            Light.RED,
            f"{int((~finite).sum())} of {len(forces)} forces are not finite",
            "look for drop-outs in the sensor or its driver: such a wrench is never believed",
        )
    force = float(np.median(forces))
    if force < 3.0:
        return Check(name, Light.GREEN, f"{force:.1f} N without contact")
    return Check(
        name,
        Light.YELLOW,
        f"{force:.1f} N without contact",
        "set mass and centre of the tool in Desk, then call arm/tare",
    )


def judge_pump(heard: Heard, fault: str) -> Check:
    """Check that the pump answers."""
    if not heard.times:
        return Check(
            "pump",
            Light.RED,
            "no suction/measurement",
            "start `flowbothd up robot`; Desk, Settings, End-Effector must say Cobot Pump",
        )
    if fault:
        return Check("pump", Light.RED, fault, "see its display and pump_node's log")
    return Check("pump", Light.GREEN, f"answers at {heard.rate:.0f} Hz")


def judge_nodes(expected: Sequence[str], said: dict[str, tuple[bool, str]]) -> list[Check]:
    """Check that every node is alive and ready; a node that is not is quoted."""
    checks = []
    for name in expected:
        if name not in said:
            text = "start `flowbothd up robot`, or see its log"
            checks.append(Check(name, Light.RED, "not heard", text))
        elif not said[name][0]:
            checks.append(Check(name, Light.RED, said[name][1] or "not ready", "as it says"))
        else:
            checks.append(Check(name, Light.GREEN, said[name][1] or "ready"))
    return checks


def as_text(checks: Sequence[Check], *, colour: bool) -> str:
    """The list for people, each remedy below its finding."""
    marks = {
        Light.GREEN: ("ok ", "32"),
        Light.YELLOW: ("?  ", "33"),
        Light.RED: ("NO ", "31"),
        Light.SKIPPED: ("-  ", "2"),
    }
    lines = []
    for check in checks:
        mark, code = marks[check.light]
        shown = f"\x1b[{code}m{mark}\x1b[0m" if colour else mark
        lines.append(f"{shown} {check.name}: {check.found}")
        if check.remedy:
            lines.append(f"      -> {check.remedy}")
    red = sum(check.light is Light.RED for check in checks)
    lines.append("all is well" if not red else f"{red} of {len(checks)} are red")
    return "\n".join(lines)
