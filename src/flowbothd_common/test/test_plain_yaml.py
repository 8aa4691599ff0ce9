"""YAML for ROS."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from flowbothd_common.plain_yaml import plain_yaml


def test_one_list_in_two_places_is_written_twice():
    """An alias in a parameter file makes rcl refuse it, and one in its metadata closes a bag."""
    corner = [0.1, 0.2]
    text = plain_yaml({"min_corner": corner, "max_corner": corner})
    assert "&" not in text and "*" not in text
    assert yaml.safe_load(text) == {"min_corner": corner, "max_corner": corner}


def test_mappings_keep_their_order_or_are_sorted():
    values = {"b": 1, "a": {"d": 2, "c": 3}}
    assert plain_yaml(values) == "b: 1\na:\n  d: 2\n  c: 3\n"
    assert plain_yaml(values, sort_keys=True) == "a:\n  c: 3\n  d: 2\nb: 1\n"


def test_values_that_ros_would_not_read_back_are_refused():
    with pytest.raises(yaml.representer.RepresenterError):
        plain_yaml({"gain": np.float64(1.0)})
