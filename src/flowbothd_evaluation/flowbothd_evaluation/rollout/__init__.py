"""Whole runs without ROS: the policy, a predictor and a stepped world, repeatable bit for bit."""
