"""Measured speed and correctness of perception, motion, simulation and recording."""
