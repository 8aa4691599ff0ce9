"""Predictions are computed again by the predictor that a recording names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("mcap", reason="mcap is not installed")
pytest.importorskip("rclpy", reason="ROS is not installed")
from flowbothd.replay.story import predictor_name, read_story
from flowbothd_policy.commands import Predict
from flowbothd_rosbag.metadata import BagError, Topic
from flowbothd_rosbag.reader import Bag
from flowbothd_rosbag.writer import BagWriter
from sim_bridge.oracle import GroundTruthFlow, OracleParams, draw

pytestmark = pytest.mark.ros

POINTS = np.random.default_rng(1).uniform(-0.3, 0.3, (40, 3)).astype(np.float32)
FLOWS = np.stack([np.eye(3, dtype=np.float32)[[axis] * len(POINTS)] for axis in (0, 1)])
STAMP = (12, 500)
ASKED = Predict(POINTS, stamp=12.0, history=None, samples=4, seed=99)

NOW = {"oracle_node": {"predictor": "ambiguous", "noise": 0.25, "truth_timeout": 5.0}}
BEFORE = {
    "inference_node": {"predictor": "ambiguous", "noise": 0.25, "model_path": "compact-doors"}
}
"""The same oracle as recordings name it now, and as they did when inference_node served it."""


def recording(folder: Path, parameters: dict[str, Any], *, truth: bool = True) -> Bag:
    """Write a recording of one answer of the simulation about POINTS, and open it."""
    from builtin_interfaces.msg import Time
    from rclpy.serialization import serialize_message
    from std_msgs.msg import Header

    from flowbothd_common.ros import clouds
    from flowbothd_interfaces.srv import GroundTruthFlow as Service

    writer = BagWriter(folder / "bag")
    name = "/sim/ground_truth_flow/_service_event"
    writer.add_topic(Topic(name, "flowbothd_interfaces/srv/GroundTruthFlow_Event"))
    if truth:
        header = Header(frame_id="panda_link0", stamp=Time(sec=STAMP[0], nanosec=STAMP[1]))
        flows = clouds.to_flow_message(header, POINTS, FLOWS)
        answer = Service.Response(flows=flows, modes=["pull", "push"], ok=True)
        writer.write(name, 1, serialize_message(Service.Event(response=[answer])))
    stored = {node: {"ros__parameters": values} for node, values in parameters.items()}
    writer.attach("parameters.yaml", "application/yaml", yaml.safe_dump(stored).encode())
    writer.close()
    return Bag(folder / "bag")


@pytest.mark.parametrize("parameters", [NOW, BEFORE], ids=["oracle_node", "inference_node"])
def test_an_oracle_draws_the_same_samples_again(tmp_path: Path, parameters: dict[str, Any]) -> None:
    """The incident this guards against: an old recording of an oracle asks for weights.

    Recordings made before oracle_node existed name the oracle among inference_node's parameters.
    """
    from flowbothd.replay.inference_run import Inference

    inference = Inference(read_story(recording(tmp_path, parameters)))
    truth = GroundTruthFlow(FLOWS, ("pull", "push"), 0.0)
    drawn = draw(truth, OracleParams("ambiguous", noise=0.25), ASKED.samples, ASKED.seed)
    np.testing.assert_array_equal(inference.answer(ASKED, STAMP), drawn)
    assert inference.problems == []


def test_an_oracle_without_the_recorded_truth_is_refused(tmp_path: Path) -> None:
    from flowbothd.replay.inference_run import Inference

    inference = Inference(read_story(recording(tmp_path, NOW, truth=False)))
    with pytest.raises(BagError, match=r"no true flow for the cloud at \(12, 500\)"):
        inference.answer(ASKED, STAMP)


def test_a_recording_without_a_predictor_is_refused(tmp_path: Path) -> None:
    from flowbothd.replay.inference_run import Inference

    story = read_story(recording(tmp_path, {"policy_node": {"seed": 1}}))
    with pytest.raises(BagError, match="neither of inference_node nor of oracle_node"):
        Inference(story)


@pytest.mark.parametrize(
    ("parameters", "name"),
    [
        (NOW, "ambiguous"),
        (BEFORE, "ambiguous"),
        ({"inference_node": {"model_path": "compact-doors"}}, "model"),
        ({"inference_node": {"predictor": "model", "model_path": "compact-doors"}}, "model"),
        ({"policy_node": {"seed": 1}}, "unknown"),
    ],
)
def test_reports_name_the_predictor(parameters: dict[str, Any], name: str) -> None:
    assert predictor_name(parameters) == name
