"""Words and what they mean."""

from __future__ import annotations

import math

import pytest

import flexhinf as fh
from flexhinf.cli.values import angles, bandwidths, names, numbers, weights


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("", None),
        ("4", 4.0),
        ("4rad/s", 4.0),
        (" 4 rad/s ", 4.0),
        ("0.6Hz", 1.2 * math.pi),
        ("1 hz", 2 * math.pi),
        ("4,6", (4.0, 6.0)),
        ("4rad/s, 1Hz", (4.0, 2 * math.pi)),
    ],
)
def test_a_bandwidth_is_in_rad_per_second_unless_it_says_hertz(text: str, meant: object) -> None:
    assert bandwidths(text) == meant


@pytest.mark.parametrize("text", ["4xyz", "Hz", "4,", ",", "fast", "4 6", "4deg"])
def test_what_is_no_bandwidth_is_told_with_an_example(text: str) -> None:
    with pytest.raises(fh.InvalidInput, match="bandwidth cannot be read") as caught:
        bandwidths(text)
    assert repr(text) in caught.value.found
    assert "0.6Hz" in caught.value.advice


def test_angles_are_in_radians_unless_they_say_degrees() -> None:
    assert angles("pose", "0.5,-90deg, 180 deg") == (0.5, -math.pi / 2, math.pi)
    with pytest.raises(fh.InvalidInput, match="pose cannot be read"):
        angles("pose", "90grad")


def test_names_numbers_and_weights_stand_between_commas() -> None:
    assert names(" a, b ,,") == ("a", "b")
    assert numbers("degrees", "2,4", int) == (2, 4)
    assert weights("penalty", "") is None
    assert weights("penalty", "60,0,300") == (60.0, 0.0, 300.0)
    assert weights("penalty", "link_position=60, motor_velocity = 3") == {
        "link_position": 60.0,
        "motor_velocity": 3.0,
    }
    with pytest.raises(fh.InvalidInput, match="penalty cannot be read"):
        weights("penalty", "link_position=a")
