"""Collision-free paths: inverse kinematics, collision checks, path search."""
