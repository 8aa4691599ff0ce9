"""The arm: description, kinematics, limits and trajectories."""
