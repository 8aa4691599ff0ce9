"""Read a recording, and let the policy decide again on what it was given then.

    python examples/replay_a_bag.py out/demo/bag           # `make demo` leaves this one

Recordings are rosbag2 folders, so that other tools read them too. The messages need ROS, from apt
or from the wheels that `make setup` installs; no node has to run.
"""

import argparse
import os
import sys
from pathlib import Path

# ROS finds its packages by this when rclpy is imported; a sourced ROS has set it already.
os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)

from flowbothd.replay.recompute import recompute
from flowbothd.replay.story import decoded, topic_called
from flowbothd_rosbag.reader import Bag


def main() -> int:
    """Print what is in the bag and how the decisions compare; 0 if all are the same."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bag", type=Path, help="folder of the recording")
    bag = Bag(parser.parse_args().bag)

    print(f"{sum(bag.counts.values())} messages on {len(bag.topics)} topics")
    for name, count in sorted(bag.counts.items()):
        print(f"  {name:<36} {count:6d}  {bag.topics[name].type}")

    topic = topic_called(bag, "motion/result")
    if topic is not None:
        for message in bag.messages([topic]):
            result = decoded(bag, message)
            print(f"{message.time * 1e-9:.2f} s: {result.motion} {result.reason}")

    again = recompute(bag, ["policy"])
    print(again.text())
    return 0 if again.identical else 1


if __name__ == "__main__":
    sys.exit(main())
