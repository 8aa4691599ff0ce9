"""The table of renamed names against the names of today."""

from __future__ import annotations

import pytest

from flowbothd_common.parameters import specifications
from flowbothd_perception.params import PerceptionNodeParams
from flowbothd_policy.params import PolicyNodeParams
from flowbothd_rosbag.renamed import PARAMETERS, TYPES, VALUES
from franka_suction_driver.backend_params import ArmNodeParams, PumpNodeParams
from franka_suction_driver.params import MotionNodeParams

NODES = {
    "perception_node": PerceptionNodeParams,
    "motion_node": MotionNodeParams,
    "policy_node": PolicyNodeParams,
    "arm_node": ArmNodeParams,
    "pump_node": PumpNodeParams,
}


@pytest.mark.parametrize("node", PARAMETERS)
def test_parameters_are_renamed_to_what_the_node_has(node: str):
    """A name that is changed once more would leave old recordings with the node's default."""
    known = {spec.name for spec in specifications(NODES[node])}
    assert set(PARAMETERS[node].values()) <= known
    assert not set(PARAMETERS[node]) & known


def test_values_are_renamed_to_what_the_parameter_allows():
    for (node, name), values in VALUES.items():
        spec = next(s for s in specifications(NODES[node]) if s.name == name)
        assert set(values.values()) <= set(spec.choices)
        assert not set(values) & set(spec.choices)


@pytest.mark.ros
def test_types_are_renamed_to_what_is_installed():
    pytest.importorskip("rclpy", reason="ROS is not installed")
    from flowbothd_rosbag.types_ros import message_class, type_of

    for new in TYPES.values():
        assert type_of(message_class(new)).split("/")[-1] == new.split("/")[-1]
