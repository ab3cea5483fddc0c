"""The knob of a family against responses whose answer is known, and against a loop."""

import numpy as np
import pytest

from flexhinf.baselines import MotorPD, lqr, tune
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.loop import Controller, Loop


def same(knob):
    return knob


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("response", "target", "answer"),
    [
        (lambda k: 3.0 * k**2, 60.0, np.sqrt(20.0)),
        (lambda k: 100.0 / k, 60.0, 100.0 / 60.0),
        (lambda k: 1e-4 * k, 60.0, 6e5),
        (lambda k: 5.0, 5.05, 1.0),  # within the tolerance where it starts
        (lambda k: 10.0 + abs(k - 8.0), 40.0, 38.0),  # falls first, then rises
    ],
)
@pytest.mark.parametrize("tolerance", [0.02, 1e-4])
def test_the_knob_is_found(response, target, answer, tolerance):
    if answer == 1.0 and tolerance < 0.01:
        target = 5.0
    found = tune(same, response, target, start=1.0, tolerance=tolerance, evaluations=60)
    assert found.met
    assert found.reason == ""
    assert found.required() is found
    np.testing.assert_allclose(response(found.knob), target, rtol=tolerance)
    np.testing.assert_allclose(found.knob, answer, rtol=2.0 * tolerance)
    assert found.law == found.knob
    assert found.response == response(found.knob)
    assert found.trials[0].knob == 1.0


def test_a_bound_that_binds_is_said():
    found = tune(same, lambda k: k, 60.0, start=1.0, bounds=(0.5, 10.0))
    assert not found.met
    assert (found.knob, found.response) == (10.0, 10.0)
    assert "the knob is at its bound 10" in found.reason
    with pytest.raises(
        NumericalFailure, match=r"(?s)No value of the knob.*expected 60, the best found is 10 at 10"
    ):
        found.required()


def test_a_limit_of_the_loop_that_binds_is_said_and_approached():
    def response(k):
        if k > 7.3:
            raise NumericalFailure("The loop diverged.", f"at {k}", "less")
        return k

    found = tune(same, response, 60.0, start=1.0)
    assert not found.met
    assert 7.3 / 1.03 < found.knob <= 7.3
    assert "The loop diverged." in found.reason
    assert any(trial.response is None and trial.failure == "The loop diverged." for trial in found.trials)


def test_a_start_that_cannot_be_made_is_left():
    def make(k):
        if k > 0.3:
            raise InvalidInput("Too much.", f"got {k}", "less")
        return k

    found = tune(make, lambda k: 2.0 * k, 0.1, start=1.0)
    assert found.met
    np.testing.assert_allclose(found.knob, 0.05, rtol=0.02)
    assert found.trials[0].law is None


def test_a_response_that_is_no_number_counts_as_none():
    found = tune(same, lambda k: np.nan if k > 3.0 else k, 60.0, start=1.0)
    assert not found.met
    assert "the response is nan" in found.reason


def test_a_jump_across_the_target_is_said():
    found = tune(same, lambda k: 1.0 if k < 5.0 else 9.0, 4.0, start=1.0, evaluations=80)
    assert not found.met
    assert "jumps across the target at 5" in found.reason


def test_evaluations_are_counted():
    found = tune(same, lambda k: k, 1e5, start=1.0, evaluations=5)
    assert not found.met
    assert len(found.trials) == 5
    assert "after 5 evaluations" in found.reason


def test_nothing_to_be_had_is_an_error():
    def make(k):
        raise InvalidInput("Never.", "", "")

    with pytest.raises(NumericalFailure, match=r"(?s)No value of the knob gives a law.*Never"):
        tune(make, same, 1.0, start=1.0, bounds=(0.5, 2.0))


@pytest.mark.parametrize(
    "settings",
    [
        {"target": 0.0}, {"start": -1.0}, {"start": 20.0}, {"bounds": (2.0, 1.0)}, {"tolerance": 0.0},
        {"target": np.nan}, {"evaluations": 2},
    ],
)  # fmt: skip
def test_a_search_that_is_not_well_posed_is_refused(settings):
    with pytest.raises(InvalidInput, match="not well posed"):
        tune(same, same, **{"target": 1.0, "start": 1.0, "bounds": (0.1, 10.0), **settings})


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["pd", "lqr"])
def test_two_laws_at_the_same_peak_voltage(made, kind):
    robot = made.robots["paper"]
    problem, plant = robot.problem(), robot.plant()
    goal = np.concatenate(robot.operating_point([np.pi / 2]))

    def peak(law):
        run = Loop(plant, Controller(law, None, moving=True)).run(goal, duration=3.0)
        return float(np.abs(run.signals["input"]).max())

    family = {"pd": lambda k: MotorPD.tuned(problem, k, 0.7), "lqr": lambda k: lqr(problem, effort=k)}[kind]
    found = tune(family, peak, 60.0, start=3.0 if kind == "pd" else 1.0)
    assert found.met
    np.testing.assert_allclose(peak(family(found.knob)), 60.0, rtol=0.02)
