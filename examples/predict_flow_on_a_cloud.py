"""Predict how every point of a cloud would move if its part opened.

    python examples/predict_flow_on_a_cloud.py                 # a cupboard made for this run
    python examples/predict_flow_on_a_cloud.py cloud.npy       # your own: (N, 3) float32 [m]

A closed door does not show which side opens. The network therefore draws several answers; samples
that differ are different hypotheses about the joint, not noise.
"""

import argparse
from pathlib import Path

import numpy as np

from flowbothd_model.data.procedural.catalogue import make
from flowbothd_model.data.sampling import SampleConfig, Situation, draw_sample
from flowbothd_model.predictor import load


def cupboard(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) points of a closed cupboard as a camera sees it, and their true flow."""
    rng = np.random.default_rng(seed)
    item = make("StorageFurniture", seed)
    sample = draw_sample(item, Situation.CLOSED, SampleConfig(augment=False), rng)
    if sample is None:
        raise SystemExit(f"no view of object {seed} shows a moving part: choose another --seed")
    return sample.current.points, sample.current.flow


def main() -> None:
    """Draw flows and print where each would be grasped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cloud", nargs="?", type=Path, help=".npy file with (N, 3) points [m]")
    parser.add_argument("--model", default="compact-procedural", help="name, folder or file")
    parser.add_argument("--samples", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()

    truth = None
    if given.cloud:
        points = np.load(given.cloud).astype(np.float32)
    else:
        points, truth = cupboard(given.seed)

    predictor = load(given.model)
    flows = predictor.sample(points, samples=given.samples, seed=given.seed)
    print(f"{predictor.model_id}: {len(flows)} samples for {len(points)} points")
    for number, flow in enumerate(flows):
        # The longest flow is where a pull has the most leverage.
        length = np.linalg.norm(flow, axis=1)
        best = int(length.argmax())
        line = f"sample {number}: grasp {points[best].round(3)} pull {flow[best].round(2)}"
        if truth is not None:
            cosine = np.sum(flow * truth, axis=1)[np.linalg.norm(truth, axis=1) > 0.1].mean()
            line += f", agreement with the truth {cosine:+.2f}"
        print(line)


if __name__ == "__main__":
    main()
