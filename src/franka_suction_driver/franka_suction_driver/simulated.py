"""Parameters of the motion core against a simulated arm."""

from __future__ import annotations

from pathlib import Path

from flowbothd_common.parameter_files import read_parameters
from flowbothd_common.parameters import build, specifications
from franka_suction_driver.params import MotionParams

SIMULATED_ARM = Path(__file__).parent / "config" / "simulated_arm.yaml"
"""Parameter file that motion_node takes in the simulated graph."""


def sim_motion_params() -> MotionParams:
    """Return the parameters that the simulated graph and the stepped rollouts share."""
    given = read_parameters(SIMULATED_ARM)["motion_node"]
    known = {spec.name for spec in specifications(MotionParams)}
    return build(MotionParams, {name: v for name, v in given.items() if name in known})
