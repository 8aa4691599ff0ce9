"""Checks of a robot and its host before the first motion."""
