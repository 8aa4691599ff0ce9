"""Test environment: ROS finds its packages, stays on this machine, and meets nobody else."""

import os
import sys

os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
# Nothing of a test may reach a robot that the person at this machine works with.
os.environ["ROS_DOMAIN_ID"] = str(40 + os.getpid() % 60)

from hypothesis import settings

# The same examples in every run, and no verdict by the clock: other work on the machine is no bug.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")
