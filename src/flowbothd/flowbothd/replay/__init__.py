"""Replay of recordings: played to nodes, or recomputed and compared."""
