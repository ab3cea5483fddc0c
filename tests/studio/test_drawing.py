"""Units in which the page of the studio draws."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from flexhinf.studio.drawing import Scales

UNITS = {"link_position": "rad", "link_velocity": "rad/s", "quill_velocity": "m/s", "current": "A"}


@pytest.mark.parametrize(
    ("degrees", "slides", "expected"),
    [
        (
            True,
            False,
            {"link_position": "°", "link_velocity": "°/s", "quill_velocity": "m/s", "current": "A"},
        ),
        (True, True, UNITS),
        (False, False, UNITS),
    ],
)
def test_states_are_in_degrees_where_the_specification_is(
    degrees: bool, slides: bool, expected: dict[str, str]
) -> None:
    links = SimpleNamespace(slides=(slides,), position_units=("m" if slides else "rad",))
    setup = SimpleNamespace(
        specification=SimpleNamespace(in_degrees=degrees),
        robot=SimpleNamespace(links=links),
        limits=SimpleNamespace(effort_units=("V",)),
        model=SimpleNamespace(unit=UNITS.get),
    )
    nominal = cast(Any, SimpleNamespace(setup=setup))
    scales = Scales(nominal, 0)
    for name, unit in expected.items():
        factor, shown = scales.of_state(nominal, name)
        assert shown == unit
        assert math.pi * factor == pytest.approx(180.0 if unit != UNITS[name] else math.pi)
    assert math.pi * scales.factor == pytest.approx(180.0 if degrees and not slides else math.pi)
