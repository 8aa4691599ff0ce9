"""The graph against the simulation, for people with ROS from apt.

    ros2 launch flowbothd_bringup sim.launch.py object:=custom_door seed:=3 start:=true

It starts the same nodes with the same parameters as `flowbothd up sim`.
"""

import tempfile
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from flowbothd_bringup.graph import NODES, RunOptions, sim_parameters, write_parameters
from flowbothd_bringup.scenes import scene_for

ARGUMENTS = {
    "object": ("custom_door", "scene, PartNet-Mobility folder or .urdf file"),
    "mode": ("", "how an ambiguous object opens; empty: drawn from the seed"),
    "seed": ("0", "run seed"),
    "predictor": ("ambiguous", "oracle, ambiguous or model"),
    "start": ("false", "whether the policy begins by itself"),
}


def _nodes(context):
    value = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    options = RunOptions(
        int(value["seed"]), value["mode"], value["predictor"], start=value["start"] == "true"
    )
    file = Path(tempfile.mkdtemp(prefix="flowbothd-")) / "parameters.yaml"
    write_parameters(file, sim_parameters(scene_for(value["object"]), options))
    return [
        Node(
            package=module.split(".")[0],
            executable=name,
            name=name,
            output="screen",
            parameters=[str(file)],
        )
        for name, module in NODES.items()
    ]


def generate_launch_description():
    """Declare the arguments and start the nodes."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=_nodes),
        ]
    )
