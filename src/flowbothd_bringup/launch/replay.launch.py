"""A recording on its own time, for people with ROS from apt.

    ros2 launch flowbothd_bringup replay.launch.py bag:=out/demo/bag rate:=2.0 perception:=true

The same as `flowbothd replay BAG [--nodes perception]`.
"""

from pathlib import Path

from flowbothd_bringup.launching import description, is_true
from flowbothd_bringup.replay_graph import playing_graph

ARGUMENTS = {
    "bag": ("", "folder of a recording, or its data file"),
    "rate": ("1.0", "speed"),
    "begin": ("0.0", "begin this long after the first message [s]"),
    "end": ("0.0", "end there [s]; 0: at its end"),
    "loop": ("false", "start over at the end"),
    "exclude": ("", "leave out topics that match this regular expression"),
    "perception": (
        "false",
        "start perception_node as it was, leave out what it put out",
    ),
}


def _graph(values):
    return playing_graph(
        Path(values["bag"]),
        rate=float(values["rate"]),
        begin=float(values["begin"]),
        end=float(values["end"]),
        loop=is_true(values["loop"]),
        exclude=values["exclude"],
        perception=is_true(values["perception"]),
    )


def generate_launch_description():
    """Declare the arguments and start the nodes."""
    return description(ARGUMENTS, _graph)
