"""The graph against the simulation, for people with ROS from apt.

    ros2 launch flowbothd_bringup sim.launch.py object:=custom_door seed:=3 start:=true

It starts the same nodes with the same parameters as `flowbothd up sim`.
"""

from flowbothd_bringup.launching import RECORD, description, is_true
from flowbothd_bringup.sim_graph import RunOptions, sim_graph
from sim_bridge.scenes import scene_for

ARGUMENTS = {
    "object": ("custom_door", "scene, PartNet-Mobility folder or .urdf file"),
    "mode": ("", "how an ambiguous object opens; empty: drawn from the seed"),
    "seed": ("0", "run seed"),
    "predictor": ("model", "oracle, ambiguous or model"),
    "model": (
        "",
        "weights of the predictor 'model': name, folder or file; empty: those of sim.yaml",
    ),
    "start": ("false", "whether the policy begins by itself"),
    **RECORD,
}


def _graph(values):
    options = RunOptions(
        seed=int(values["seed"]),
        mode=values["mode"],
        predictor=values["predictor"],
        model=values["model"],
        start=is_true(values["start"]),
    )
    return sim_graph(scene_for(values["object"]), options)


def generate_launch_description():
    """Declare the arguments and start the nodes."""
    return description(ARGUMENTS, _graph)
