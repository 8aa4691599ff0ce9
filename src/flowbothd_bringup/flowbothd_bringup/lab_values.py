"""The values of a lab's parameter files, checked before any node starts.

Every node checks its own parameters. But then one node ends while the others run, and ROS refuses
a `30` where a double is declared.
"""

from __future__ import annotations

import difflib
from typing import Any

from flowbothd_common.errors import ParameterError
from flowbothd_common.parameters import checked, specifications
from flowbothd_perception.params import PerceptionNodeParams
from flowbothd_policy.inference_params import InferenceParams
from flowbothd_policy.params import PolicyNodeParams
from flowbothd_rosbag.player_params import PlayerParams
from flowbothd_rosbag.recorder_params import RecorderParams
from franka_suction_driver.backend_params import ArmNodeParams, PumpNodeParams
from franka_suction_driver.params import MotionNodeParams
from franka_suction_driver.suction_params import SuctionParams
from sim_bridge.oracle import OracleNodeParams
from sim_bridge.params import BridgeParams

PARAMETERS: dict[str, type] = {
    "arm_node": ArmNodeParams,
    "bridge_node": BridgeParams,
    "inference_node": InferenceParams,
    "motion_node": MotionNodeParams,
    "oracle_node": OracleNodeParams,
    "perception_node": PerceptionNodeParams,
    "player_node": PlayerParams,
    "policy_node": PolicyNodeParams,
    "pump_node": PumpNodeParams,
    "recorder_node": RecorderParams,
    "suction_node": SuctionParams,
}
"""Node -> its parameters."""

_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def checked_values(file: str, node: str, values: dict[str, Any]) -> dict[str, Any]:
    """Return the values in the types that the node declares.

    Args:
        file: Name of the file that they are from.
        node: A key of `PARAMETERS`.
        values: By dotted name.

    Raises:
        ParameterError: the node has no such parameter, or the value is not allowed.
    """
    known = {spec.name: spec for spec in specifications(PARAMETERS[node])}
    result = {}
    for name, value in values.items():
        if name in known:
            try:
                fitting = checked(known[name], value)
            except ParameterError as error:
                raise ParameterError(
                    f"{file}, {node}: {error.what}", got=error.got, allowed=error.allowed
                ) from error
            result[name] = list(fitting) if isinstance(fitting, tuple) else fitting
        elif name.startswith(_OF_ROS):
            result[name] = value
        else:
            near = difflib.get_close_matches(name, known, n=3) or sorted(known)
            raise ParameterError(f"{file}: {node} has no parameter {name}", allowed=", ".join(near))
    return result
