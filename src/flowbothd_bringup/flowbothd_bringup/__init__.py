"""Launch files, parameters and the description of each node graph."""
