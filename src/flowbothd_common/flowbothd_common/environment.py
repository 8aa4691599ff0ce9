"""The environment in which nodes run: where ROS finds packages, who sees whom, which transport."""

from __future__ import annotations

import os
import sys
from importlib.resources import files

from flowbothd_common.errors import ParameterError
from flowbothd_common.parent_watch import PARENT_PID

FIRST_DOMAIN, LAST_DOMAIN = 1, 101
"""Domains whose ports are free on every Linux by default."""


def own_domain() -> int:
    """A ROS domain that other graphs on this machine are unlikely to use."""
    return FIRST_DOMAIN + os.getpid() % (LAST_DOMAIN - FIRST_DOMAIN + 1)


def node_environment(domain: int) -> dict[str, str]:
    """Environment of the nodes of one graph.

    Args:
        domain: ROS domain, 0..101; graphs in different domains do not see each other.

    Raises:
        ParameterError: the domain is out of range.
    """
    if not 0 <= domain <= LAST_DOMAIN:
        raise ParameterError("ROS domain out of range", got=domain, allowed=f"0..{LAST_DOMAIN}")
    environment = dict(os.environ)
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    environment.setdefault("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    environment.setdefault(
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        str(files("flowbothd_common") / "config" / "fastdds_shm.xml"),
    )
    environment["ROS_DOMAIN_ID"] = str(domain)
    environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    environment["PYTHONUNBUFFERED"] = "1"
    environment[PARENT_PID] = str(os.getpid())
    # Linear algebra on many small matrices gains nothing from threads, and they steal the camera's.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        environment.setdefault(name, "1")
    return environment
