"""Parameter dataclasses: description, bounds, groups, messages."""

from dataclasses import dataclass

import pytest

from flowbothd_common.errors import ParameterError
from flowbothd_common.parameters import build, flatten, group, parameter, specifications


@dataclass(frozen=True)
class Crop:
    corner: tuple[float, ...] = parameter((0.0, 0.0, 0.0), "corner of the box [m]", length=3)


@dataclass(frozen=True)
class Params:
    rate: float = parameter(5.0, "rate [Hz]", minimum=0.1, maximum=100.0)
    count: int = parameter(1200, "number of points", minimum=1)
    mode: str = parameter("depth", "kind of input", choices=("depth", "cloud"))
    watch: tuple[str, ...] = parameter((), "nodes to watch", element=str)
    crop: Crop = group(Crop)


def test_groups_are_dotted_and_flatten_inverts_build():
    names = [spec.name for spec in specifications(Params)]
    assert names == ["rate", "count", "mode", "watch", "crop.corner"]
    params = build(Params, {"rate": 2, "crop.corner": [1.0, 2.0, 3.0], "watch": ["a"]})
    assert params.rate == 2.0 and isinstance(params.rate, float)
    assert params.crop.corner == (1.0, 2.0, 3.0)
    assert build(Params, flatten(params)) == params


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"rate": 1000.0}, "0.1 <= x <= 100"),
        ({"rate": "fast"}, "double"),
        ({"rate": float("nan")}, "rate is not finite"),
        ({"rate": float("-inf")}, "rate is not finite"),
        ({"rate": 10**400}, "rate is not finite"),
        ({"crop.corner": [0.0, float("nan"), 1.0]}, "crop.corner is not finite"),
        ({"count": float("nan")}, "integer"),
        ({"count": 3.5}, "integer"),
        ({"count": True}, "integer"),
        ({"mode": "video"}, "depth, cloud"),
        ({"crop.corner": [1.0]}, "3"),
        ({"watch": "policy"}, "string"),
        ({"rte": 1.0}, "rate"),
    ],
)
def test_a_bad_value_is_refused_and_the_message_tells_what_is_allowed(values, said):
    with pytest.raises(ParameterError) as caught:
        build(Params, values)
    assert said in str(caught.value)
    assert str(caught.value.got) in str(caught.value)


def test_a_description_is_mandatory():
    with pytest.raises(ValueError, match="description"):
        parameter(1.0, "")
