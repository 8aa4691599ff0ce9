"""The suction gripper: its state machine and its node."""
