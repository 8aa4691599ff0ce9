"""Motion and suction for a Franka arm with a suction cup."""
