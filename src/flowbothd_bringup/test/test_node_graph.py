"""A described graph: its processes get the parameters, names and namespace that it has."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from flowbothd_bringup.node_graph import RECORDER, NodeGraph
from flowbothd_bringup.robot_graph import NODES as ROBOT_NODES
from flowbothd_bringup.sim_graph import (
    INFERENCE,
    MODEL,
    ORACLE,
    PREDICTORS,
    RunOptions,
    sim_graph,
)
from flowbothd_bringup.sim_graph import NODES as SIM_NODES
from flowbothd_common.environment import node_environment
from flowbothd_common.errors import ParameterError
from flowbothd_common.parameter_files import read_parameters
from sim_bridge.scenes import scene_for

SUCTION = {"suction_node": SIM_NODES["suction_node"]}
FOUND_WITHIN = 30.0
"""Ten times what one node takes to start on two idle cores [s]."""


def test_a_recorder_joins_a_graph_and_keeps_what_a_file_said_of_it(tmp_path: Path) -> None:
    graph = NodeGraph(SUCTION, {RECORDER: {"profile": "all", "out": "elsewhere"}})
    recorded = graph.recorded(out="here")
    assert list(recorded.nodes) == ["suction_node", RECORDER]
    file = tmp_path / "parameters.yaml"
    processes = recorded.processes(file, required=SUCTION)
    assert [(p.name, p.required) for p in processes] == [("suction_node", True), (RECORDER, False)]
    assert read_parameters(file)[RECORDER] == {"profile": "all", "out": "here"}
    assert list(graph.nodes) == ["suction_node"]


def test_what_decides_is_the_same_in_simulation_and_on_a_robot() -> None:
    shared = set(SIM_NODES) & set(ROBOT_NODES)
    assert set(SIM_NODES) - shared == {"bridge_node"}
    assert set(ROBOT_NODES) - shared == {"arm_node", "pump_node"}


@pytest.mark.parametrize("predictor", PREDICTORS)
def test_one_node_predicts_and_the_others_watch_it(predictor: str) -> None:
    """The incident this guards against: a run that waits for a node that is not in its graph."""
    graph = sim_graph(scene_for("drawer"), RunOptions(predictor=predictor, model="compact"))
    server, other = INFERENCE, ORACLE
    if predictor != MODEL:
        server, other = ORACLE, INFERENCE
        assert graph.parameters[ORACLE]["predictor"] == predictor
    else:
        assert graph.parameters[INFERENCE]["model_path"] == "compact"
    assert server in graph.nodes and other not in {*graph.nodes, *graph.parameters}
    assert graph.parameters[server]["use_sim_time"] is True
    watching = [
        value
        for values in graph.parameters.values()
        for value in values.values()
        if isinstance(value, list) and "perception_node" in value
    ]
    assert len(watching) == 2, "policy_node and motion_node watch the others"
    assert all(server in names and other not in names for names in watching)


def test_an_unknown_predictor_is_refused() -> None:
    with pytest.raises(ParameterError, match="got psychic; allowed: model, oracle, ambiguous"):
        sim_graph(scene_for("drawer"), RunOptions(predictor="psychic"))


@pytest.mark.ros
@pytest.mark.parametrize("namespace", ["", "/left"])
def test_names_and_parameters_hold_in_the_namespace(tmp_path: Path, namespace: str) -> None:
    """The incident: parameters of a graph under a namespace were dropped without a word."""
    import rclpy
    from rcl_interfaces.srv import GetParameters
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    parameters = {"suction_node": {"release_timeout": 7.5}}
    graph = NodeGraph(SUCTION, parameters, {"suction/state": "cup/state"}, namespace)
    (described,) = graph.processes(tmp_path / "parameters.yaml")
    domain = int(os.environ["ROS_DOMAIN_ID"])
    process = subprocess.Popen(described.command, env=node_environment(domain))
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    ear = Node("ear", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(ear)
    try:
        service = f"{namespace}/suction_node/get_parameters"
        client = ear.create_client(GetParameters, service)
        assert client.wait_for_service(FOUND_WITHIN), f"no service {service}"
        future = client.call_async(GetParameters.Request(names=["release_timeout"]))
        executor.spin_until_future_complete(future, FOUND_WITHIN)
        assert future.done() and future.result().values[0].double_value == 7.5
        deadline = time.monotonic() + FOUND_WITHIN
        while not ear.get_publishers_info_by_topic(f"{namespace}/cup/state"):
            assert time.monotonic() < deadline, "the remapped topic has no publisher"
            executor.spin_once(timeout_sec=0.1)
        assert not ear.get_publishers_info_by_topic(f"{namespace}/suction/state")
    finally:
        process.terminate()
        process.wait(timeout=20)
        executor.shutdown(timeout_sec=1.0)
        ear.destroy_node()
        rclpy.shutdown(context=context)
