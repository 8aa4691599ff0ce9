"""Recordings made to happen again: played to nodes, or computed anew and compared."""
