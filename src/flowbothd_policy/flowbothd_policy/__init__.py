"""The articulation manipulation policy, its node and the inference node."""
