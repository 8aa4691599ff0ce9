"""Where the camera is: from a printed board on the tool, or from the tool itself."""
