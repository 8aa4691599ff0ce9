"""Objects to be opened: their model, the built-in ones, and the reading of published ones."""

from sim_bridge.objects.model import Joint, Link, ObjectModel
from sim_bridge.objects.registry import load_object, object_modes, object_names

__all__ = ["Joint", "Link", "ObjectModel", "load_object", "object_modes", "object_names"]
