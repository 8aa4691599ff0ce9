"""Checks of this computer, without ROS: libraries, kernel, network."""

from __future__ import annotations

import importlib.util
import socket
from pathlib import Path
from typing import Any

from flowbothd.doctor.doctor_checks import Check, Light
from flowbothd_common.errors import FlowBotError
from franka_suction_driver.backends.library import INSTALL, load_panda_py

_DESK_PORT = 443
_FCI_PORT = 1337


def check_host(backend: str, robot_ip: str) -> list[Check]:
    """Everything about this computer and its way to the robot."""
    checks = [_kernel()]
    if backend == "panda":
        checks += [_library(), *_priority(), *_reachable(robot_ip)]
    return checks


def _kernel() -> Check:
    if Path("/sys/kernel/realtime").exists():
        return Check("real-time kernel", Light.GREEN, "PREEMPT_RT")
    return Check(
        "real-time kernel",
        Light.YELLOW,
        "this kernel is not a real-time one",
        "install a PREEMPT_RT kernel if communication_constraints_violation comes up",
    )


def _library() -> Check:
    if importlib.util.find_spec("panda_py") is None:
        return Check("panda-python", Light.RED, "not installed", INSTALL)
    try:
        load_panda_py()
    except FlowBotError as error:
        return Check("panda-python", Light.RED, str(error), INSTALL)
    return Check("panda-python", Light.GREEN, "imports")


def _priority() -> list[Check]:
    try:
        library: Any = load_panda_py()
    except FlowBotError:
        return []
    possible, message = library.realtime_priority_available()
    if possible:
        return [Check("real-time priority", Light.GREEN, "may be asked for")]
    remedy = "put the user into the group realtime, with rtprio 99 in /etc/security/limits.conf"
    return [Check("real-time priority", Light.YELLOW, message or "not permitted", remedy)]


def _reachable(robot_ip: str) -> list[Check]:
    if not robot_ip:
        return [Check("robot", Light.RED, "no address", "give --robot, or panda.robot_ip")]
    checks = []
    for name, port, remedy in (
        ("Desk", _DESK_PORT, f"connect the control unit's LAN port and ping {robot_ip}"),
        ("FCI", _FCI_PORT, "unlock the joints and activate FCI in Desk"),
    ):
        try:
            socket.create_connection((robot_ip, port), timeout=1.0).close()
            checks.append(Check(name, Light.GREEN, f"{robot_ip}:{port} answers"))
        except OSError as error:
            text = f"{robot_ip}:{port} does not answer: {error}"
            checks.append(Check(name, Light.RED, text, remedy))
    return checks
