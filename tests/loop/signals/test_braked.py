"""A signal that is braked: its path, its derivatives by finite differences, and where it stops."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.loop.signals.references import braked

WAVE = fh.Sine(0.7, 0.4, phase=0.3)


def test_it_is_the_signal_before_and_rests_on_its_path_after() -> None:
    braked = fh.Braked(WAVE, at=0.5, time=0.3)
    early, late = np.linspace(0.0, 0.5, 20), np.linspace(0.8, 3.0, 20)
    assert np.array_equal(braked.derivatives(early[:-1]), WAVE.derivatives(early[:-1]))
    assert braked(late) == pytest.approx(np.full(20, WAVE(0.65)), abs=1e-14)
    assert np.abs(braked.derivatives(late)[1:]).max() < 1e-9
    assert braked(2.0) == pytest.approx(float(WAVE(0.65)))
    assert fh.Braked(WAVE, at=0.5, time=0.3).derivatives(0.6, 1).shape == (2,)


@pytest.mark.oracle
@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_derivatives_are_those_of_the_positions(order: int) -> None:
    """Central differences of the derivative below, also across both ends of the braking."""
    braked, t, h = fh.Braked(WAVE, at=0.5, time=0.3), np.linspace(0.4, 0.9, 201), 1e-5
    slope = (braked.derivatives(t + h, order)[order - 1] - braked.derivatives(t - h, order)[order - 1]) / (
        2.0 * h
    )
    own = braked.derivatives(t, order)[order]
    assert np.abs(slope - own).max() < 2e-3 * np.abs(own).max()


def test_motions_of_several_joints_are_braked_as_one() -> None:
    plan = fh.JerkLimited([0.0, 1.0], [1.0, 3.0], 1.0, 5.0, 50.0, smoothing=0.05)
    braked = fh.Braked(plan, at=0.4, time=0.2)
    assert braked.derivatives(np.linspace(0.0, 1.0, 7)).shape == (5, 7, 2)
    assert braked(1.0) == pytest.approx(plan(0.5))
    robot = fh.load_robot("planar-two-link")
    moving = fh.Moving(braked, robot.inverse_dynamics)
    there, holding = robot.operating_point(plan(0.5))
    assert moving(2.0) == pytest.approx(np.concatenate([there, holding]), abs=1e-9)
    assert "0.4" in braked.name


def test_commands_of_all_kinds_are_braked() -> None:
    """By name, in a list, a function of time, a number; a moving reference has the speeds of the braked path."""
    at, time, late = 0.4, 0.2, 2.0
    wanted = WAVE(0.5)
    by_name = braked({"a": WAVE, "b": 0.3}, at, time)
    several = braked([WAVE, lambda t: float(WAVE(t))], at, time)
    assert (by_name["a"](late), by_name["b"]) == (pytest.approx(wanted), 0.3)
    assert [one(late) for one in several] == pytest.approx([wanted, wanted])
    robot = fh.load_robot("planar-two-link")
    moving = fh.Moving({"one": WAVE, "two": 0.2}, robot.inverse_dynamics, ("one", "two"))
    slow, h = braked(moving, at, time), 1e-6
    assert np.array_equal(slow(0.3), moving(0.3))
    assert slow(late) == pytest.approx(np.concatenate(robot.operating_point([wanted, 0.2])), abs=1e-9)
    names = robot.plant().states
    speed = (slow.state(0.5 + h) - slow.state(0.5 - h))[names.index("link_position_shoulder")] / (2.0 * h)
    assert slow.state(0.5)[names.index("link_velocity_shoulder")] == pytest.approx(speed, rel=1e-6)
    assert speed / WAVE.derivatives(0.5, 1)[1] > 0.0


def test_what_is_no_braking_is_refused() -> None:
    for options in ({"at": np.nan}, {"at": 0.0, "time": 0.0}, {"at": 0.0, "time": np.inf}):
        with refused_with(InvalidInput, "seconds"):
            fh.Braked(WAVE, **options)
    with refused_with(InvalidInput, 4, 5):
        fh.Braked(WAVE, at=0.0).derivatives(0.1, 5)
    with refused_with(InvalidInput, "fh.Spline"):
        fh.Braked(np.sin, at=0.0).derivatives(0.1)
