"""Value types refuse what later code could not use, and say so."""

import numpy as np
import pytest

from flowbothd_common.errors import InvalidCloudError
from flowbothd_common.motion import joint_order
from flowbothd_common.types import History, as_cloud


def test_as_cloud_converts_lists_and_keeps_float32_without_a_copy():
    points = np.zeros((4, 3), np.float32)
    assert as_cloud(points) is points
    assert as_cloud([[1, 2, 3]]).dtype == np.float32


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (np.zeros((4, 2)), "(4, 2)"),
        (np.zeros((0, 3)), "too few points"),
        (np.array([[0, np.nan, 0], [1, 1, 1]]), "1 of 2"),
    ],
)
def test_as_cloud_says_what_is_wrong(points, said):
    with pytest.raises(InvalidCloudError) as caught:
        as_cloud(points)
    assert said in str(caught.value)


def test_history_needs_a_flow_for_every_point():
    with pytest.raises(InvalidCloudError, match="differ in number"):
        History(np.zeros((3, 3)), np.zeros((4, 3)))


def test_joint_order_is_by_name_and_names_what_is_missing():
    assert joint_order(["b", "a"], ["a", "x", "b"]) == [2, 0]
    with pytest.raises(KeyError, match="missing: \\['c'\\]"):
        joint_order(["c"], ["a"])
