"""Nodes once more on a recording, each on what the one before put out, and the comparison."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import asdict, dataclass, field
from pathlib import Path

from flowbothd.replay.differences import Comparison, Difference, compare_arrays
from flowbothd.replay.inference_run import Inference
from flowbothd.replay.perception_run import Perceived, perceive_again
from flowbothd.replay.policy_run import Sample, compare_decisions, decide_again
from flowbothd.replay.story import Stamp, Story, read_story, seconds
from flowbothd_common.types import Cloud
from flowbothd_policy.commands import Decision, Predict
from flowbothd_rosbag.metadata import BagError
from flowbothd_rosbag.reader import Bag, Span

NODES = ("perception", "inference", "policy")
"""Nodes that can be recomputed, upstream first."""


@dataclass
class Recomputed:
    """Result of the recomputation.

    Attributes:
        comparisons: One for each node that ran again, upstream first.
        decisions: The policy's, as they came out again.
        problems: Of the recording as a whole.
    """

    comparisons: list[Comparison] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    @property
    def identical(self) -> bool:
        """True if every node reproduced the recording."""
        return bool(self.comparisons) and all(c.identical for c in self.comparisons)

    def text(self) -> str:
        """For people."""
        lines = [c.text() for c in self.comparisons]
        firsts = [(d.stamp, c.node) for c in self.comparisons if (d := c.first) is not None]
        if firsts:
            stamp, node = min(firsts)
            lines.append(f"first divergence: {node} at {stamp:.9f} s")
        return "\n".join([*self.problems, *lines])

    def write(self, path: Path) -> None:
        """Write the comparison as JSON."""
        content = {
            "identical": self.identical,
            "problems": self.problems,
            "nodes": [asdict(c) for c in self.comparisons],
        }
        path.write_text(json.dumps(content, indent=1) + "\n")


class _Sources:
    """Clouds and predictions, recorded or recomputed, compared on the way."""

    def __init__(
        self, story: Story, clouds: dict[Stamp, Cloud], inference: Inference | None
    ) -> None:
        self._story, self._clouds, self._inference = story, clouds, inference
        self.compared = Comparison("inference")

    def cloud(self, stamp: Stamp) -> Cloud:
        """The cloud that is now in use; as recorded where perception did not come that far."""
        found = self._clouds.get(stamp, self._story.clouds.get(stamp))
        if found is None:
            raise BagError(f"the recording has no object_cloud with stamp {stamp}")
        return found

    def prediction(self, stamp: Stamp, seed: int, asked: Predict | None) -> Sample:
        """Recorded, or computed from what the policy has asked for."""
        points, flows = self._story.prediction_arrays(stamp, seed)
        if self._inference is None:
            return points, flows
        at = seconds(stamp)
        what = f"flow/prediction with seed {seed}"
        if asked is None or asked.seed != seed:
            # The policy has taken another path; only its recorded inputs are available.
            other = "nothing" if asked is None else f"seed {asked.seed}"
            found = Difference(at, what, "request", f"seed {seed}", other)
            self.compared.add([found])
            return points, flows
        again = self._inference.answer(asked, stamp)
        self.compared.add(compare_arrays(at, what, flows, again))
        return asked.points, again


def recompute(bag: Bag, nodes: Collection[str], span: Span | None = None) -> Recomputed:
    """Run nodes again on a recording and compare what they put out.

    A node works on the new outputs of those upstream that run again too, on recorded ones
    otherwise. What the arm and the object did is always as recorded.

    Args:
        bag: The recording.
        nodes: Of `NODES`.
        span: Part of the recording.

    Raises:
        BagError: the recording lacks what is needed; the message says what.
    """
    unknown = set(nodes) - set(NODES)
    if unknown or not nodes:
        raise BagError("nodes to recompute", got=sorted(nodes), allowed=", ".join(NODES))
    story = read_story(bag, span)
    result = Recomputed(problems=list(bag.problems))
    new_clouds: dict[Stamp, Cloud] = {}
    if "perception" in nodes:
        perceived = perceive_again(bag, story, span)
        new_clouds = perceived.clouds
        result.comparisons.append(_compare_clouds(story, perceived))
    if set(nodes) == {"perception"}:
        return result
    inference = Inference(story) if "inference" in nodes else None
    sources = _Sources(story, new_clouds, inference)
    result.decisions = list(decide_again(story, sources))
    if inference is not None:
        sources.compared.problems += inference.problems
        result.comparisons.append(sources.compared)
    if "policy" in nodes:
        result.comparisons.append(compare_decisions(story, result.decisions))
    return result


def _compare_clouds(story: Story, again: Perceived) -> Comparison:
    result = Comparison("perception")
    for stamp, recorded in story.clouds.items():
        at = seconds(stamp)
        if stamp in again.clouds:
            result.add(compare_arrays(at, "object_cloud", recorded, again.clouds[stamp]))
        elif at >= again.begin:
            result.add([Difference(at, "object_cloud", "cloud", "there", "none came out")])
        else:
            result.left_out += 1
    if result.left_out:
        result.remark = (
            f"{result.left_out} outputs before {again.begin:.9f} s are left out: "
            "not all that the node listens to was being recorded yet"
        )
    if not story.clouds:
        result.problems.append("the recording holds no object_cloud")
    return result
