"""Which figure is better, and by how much it must be."""

from __future__ import annotations

import math

import pytest

from flexhinf.design.compare.merits import MERITS, Merit, best, judged, wins

OVERSHOOT = next(merit for merit in MERITS if merit.key == "step_overshoot_percent")
DAMPING = next(merit for merit in MERITS if merit.key == "damping")
PEAK = next(merit for merit in MERITS if merit.key == "step_peak_input")


def test_keys_are_there_once() -> None:
    assert len({merit.key for merit in MERITS}) == len(MERITS)


@pytest.mark.parametrize(
    ("merit", "a", "b", "sign"),
    [
        (OVERSHOOT, 1.0, 40.0, 1),
        (OVERSHOOT, 40.0, 1.0, -1),
        (OVERSHOOT, 0.001, 0.4, 0),  # less than half a per cent of the step
        (OVERSHOOT, 40.0, 41.0, 0),  # within 5 %
        (OVERSHOOT, 3.0, math.inf, 1),
        (OVERSHOOT, math.inf, math.inf, 0),
        (OVERSHOOT, None, 1.0, 0),
        (DAMPING, 0.3, 0.1, 1),
        (DAMPING, 0.1, 0.3, -1),
        (DAMPING, 0.3, None, 0),
    ],
)
def test_who_wins(merit: Merit, a: float | None, b: float | None, sign: int) -> None:
    assert wins(merit, {merit.key: a}, {merit.key: b}) == sign
    assert wins(merit, {merit.key: b}, {merit.key: a}) == -sign


def test_the_best_is_shared_by_what_is_as_good() -> None:
    assert best(PEAK, [10.0, 10.04, 11.0, None, math.inf]) == (True, True, False, False, False)
    assert best(DAMPING, [0.1, 0.3, None]) == (False, True, False)
    assert best(OVERSHOOT, [0.0, 0.3, 5.0]) == (True, True, False)


def test_where_all_are_alike_none_is_the_best() -> None:
    assert best(OVERSHOOT, [2.0, 2.0, None]) == (False, False, False)
    assert best(OVERSHOOT, [2.0]) == (False,)


def test_what_laws_are_tuned_to_is_not_judged() -> None:
    assert PEAK not in judged("peak")
    assert PEAK in judged("bandwidth")
    assert all(merit.key != "bandwidth_rad_s" for merit in judged("none"))
