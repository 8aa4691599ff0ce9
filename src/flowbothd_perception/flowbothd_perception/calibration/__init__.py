"""Pose of the camera: from a printed board on the tool, or from the tool itself."""
