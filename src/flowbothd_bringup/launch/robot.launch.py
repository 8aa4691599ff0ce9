"""The graph on a robot, for people with ROS from apt.

    ros2 launch flowbothd_bringup robot.launch.py robot:=172.16.0.2 params:=lab.yaml dry_run:=true

It starts the same nodes with the same parameters as `flowbothd up robot`;
see docs/tutorials/own_robot.md.
The camera's driver is started by the lab.
"""

from pathlib import Path

from flowbothd_bringup.launching import NAMESPACE, RECORD, description, is_true
from flowbothd_bringup.robot_graph import RobotOptions, robot_graph

ARGUMENTS = {
    "robot": ("", "address of the control unit"),
    "params": ("", "parameter files of the lab: calibration, limits; separated by commas"),
    "backend": ("panda", "panda, topic, or mock: everything runs, no hardware is touched"),
    "model": ("", "weights: name, folder or file"),
    "speed": ("", "part of all speeds, 0.01..1; empty: as the files say"),
    "dry_run": ("false", "plan and show, but never move"),
    "start": ("false", "whether the policy begins by itself"),
    **RECORD,
}


def _graph(values):
    options = RobotOptions(
        robot_ip=values["robot"],
        backend=values["backend"],
        files=tuple(Path(name.strip()) for name in values["params"].split(",") if name.strip()),
        model=values["model"],
        speed=float(values["speed"]) if values["speed"] else None,
        dry_run=is_true(values["dry_run"]),
        start=is_true(values["start"]),
        namespace=values[NAMESPACE],
    )
    return robot_graph(options)


def generate_launch_description():
    """Declare the arguments and start the nodes."""
    return description(ARGUMENTS, _graph)
