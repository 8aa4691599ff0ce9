"""Open a drawer with the simulated Panda, from the first picture to the open drawer.

    python examples/open_drawer_in_simulation.py
    python examples/open_drawer_in_simulation.py --object custom_door --weights compact-doors

No ROS is involved: simulation, perception, policy and motion are stepped in turn, so that the same
seed always gives the same run. Without weights, the predictor knows the simulation's true flow.
"""

import argparse
import sys

from flowbothd_evaluation.rollout.arm import arm_rollout
from flowbothd_model.predictor import load
from sim_bridge.scenes import load_scenes, scene_for


def main() -> int:
    """Run once and print what happened; return 0 if the object was opened."""
    scenes = ", ".join(sorted(set(load_scenes()) - {"default"}))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--object", default="drawer", help=f"one of {scenes}, or a .urdf file")
    parser.add_argument("--weights", default="", help="name, folder or file; none: the truth")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()

    scene = scene_for(given.object)
    predictor = load(given.weights) if given.weights else "oracle"
    record, contacts = arm_rollout(scene, seed=given.seed, predictor=predictor)

    for decision in record.decisions:
        print(f"{decision.time:6.2f} s  {decision.decision:<18} {decision.reason}")
    summary = record.summary()
    print(f"{summary.outcome}: {summary.reason}")
    print(f"open ratio {summary.open_ratio:.2f} in {summary.sim_s:.1f} s of simulated time")
    for pair, force in contacts.items():
        print(f"the arm touched: {pair}, up to {force} N")
    return 0 if summary.success else 1


if __name__ == "__main__":
    sys.exit(main())
