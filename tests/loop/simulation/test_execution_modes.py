"""Few plants or many, numbers or signals: an ensemble makes its runs in several ways, with the same bits."""

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller, Loop, Step
from flexhinf.loop.simulation.ensemble import LANES
from flexhinf.robot import paper_arm

# Kernels that run once each, in lanes: 1 s instead of 2 s; those of `test_ensemble.py` are as they ship.
pytestmark = pytest.mark.usefixtures("unoptimised")

#: The third arm is so soft that it is torn apart.
COUNT, TORN = LANES + 3, 2
PLANTS = [{"stiffness": -1e7 if k == TORN else 100.0 - k} for k in range(COUNT)]
RUN = {"reference": 0.3, "noise": 1e-3, "duration": 0.3}
LOADED = {"disturbance": {"link_torque": Step(0.2, at=0.1)}}


@pytest.fixture
def lanes(monkeypatch):
    """Call it, and also few samples are worth the lanes; with a number, so many are."""
    return lambda worth="0": monkeypatch.setenv("FLEXHINF_LANES_FROM", worth)


def looped(made, estimator=True, **options):
    return Loop(
        paper_arm().plant(), Controller(made.law, made.ukf() if estimator else None, 1e-3), 2, **options
    )


def alone(loop, k, **arguments):
    """The run of one plant, by a loop of its own."""
    one = Loop(loop.true_plant.with_parameters(**PLANTS[k]), loop.controller, 2)
    one.channel = loop.channel
    return one.run(**arguments, seed=k)


def same(one, other):
    assert (one.status, one.message, one.settings) == (other.status, other.message, other.settings)
    assert np.array_equal(one.time, other.time)
    assert list(one.signals) == list(other.signals)
    for kind, values in one.signals.items():
        assert np.array_equal(values, other.signals[kind], equal_nan=True), kind


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("options", [{}, {"delay": 2e-3, "quantisation": 1e-4}])
@pytest.mark.parametrize("worth", ["0", str(10**9)])
def test_signals_are_those_of_a_loop_alone(made, lanes, options, worth):
    lanes(worth)
    loop = looped(made, **options)
    runs = list(loop.ensemble(**RUN, **LOADED).trajectories(PLANTS, range(COUNT)))
    assert len(runs) == COUNT
    for k in (0, TORN, LANES, COUNT - 1):
        same(runs[k], alone(loop, k, **RUN, **LOADED))
    assert runs[TORN].diverged_at < runs[1].time[-1]
    assert [run.status for k, run in enumerate(runs) if k != TORN] == ["completed"] * (COUNT - 1)


def test_the_true_state_fed_back_and_a_run_alone_in_its_lanes(made, lanes):
    lanes()
    loop, given = looped(made, estimator=False), {**RUN, "noise": None}
    runs = list(loop.ensemble(**given).trajectories(PLANTS[: LANES + 1], range(LANES + 1)))
    for k, run in enumerate(runs):
        same(run, alone(loop, k, **given))


@pytest.mark.ci("compiles an ensemble and its loop")
@pytest.mark.parametrize("options", [{}, LOADED])
def test_few_plants_say_the_same_numbers_as_many(made, lanes, options):
    """On the kernel of a single run, reduced afterwards, and in lanes, reduced on the way."""
    loop = looped(made, delay=1e-3)
    kept = {
        "kept": ["input.motor_voltage", "estimate.link_velocity", "link_position"],
        "instants": [0, 7, 300],
    }
    ensemble = loop.ensemble(**RUN, **options, **kept)
    few = ensemble.run(PLANTS, range(COUNT), initial_inputs=np.linspace(-1.0, 1.0, COUNT)[:, None])
    lanes()
    many = ensemble.run(PLANTS, range(COUNT), initial_inputs=np.linspace(-1.0, 1.0, COUNT)[:, None])
    for name, values in many.metrics().items():
        np.testing.assert_array_equal(values, few.metrics()[name], err_msg=name)
    for name in ("codes", "diverged_at", "sub_steps", "kept"):
        np.testing.assert_array_equal(getattr(many, name), getattr(few, name), err_msg=name)
    assert not many.completed[TORN]
    assert np.isnan(many.kept[TORN, -1]).all()


def test_what_is_kept_are_the_signals_of_the_run(made, lanes):
    lanes()
    loop, names = looped(made), ["state.link_velocity", "estimate.link_velocity", "output.link_position"]
    found = loop.ensemble(**RUN, kept=[*names, "input.motor_voltage"], instants=range(301)).run(
        PLANTS, range(COUNT)
    )
    run = alone(loop, 5, **RUN)
    for column, text in enumerate([*names, "input.motor_voltage"]):
        np.testing.assert_array_equal(found.kept[5, :, column], run.signal(*text.split(".")))
    with pytest.raises(InvalidInput, match="colour"):
        loop.ensemble(**RUN, kept=["estimate.colour"], instants=[0])


def test_few_runs_and_few_samples_are_made_alone(made, lanes, monkeypatch):
    loop = looped(made)
    ensemble = loop.ensemble(**RUN)
    monkeypatch.setattr(type(ensemble), "_in_lanes", lambda *given: pytest.fail("not worth a kernel"))
    lanes(str(LANES * 301 + 1))
    ensemble.run(PLANTS[:LANES])
    assert len(list(ensemble.trajectories(PLANTS[:LANES]))) == LANES
    assert list(ensemble.trajectories([])) == []
    lanes()
    ensemble.run(PLANTS[: LANES - 1])
    lanes("many")
    with refused_with(InvalidInput, "FLEXHINF_LANES_FROM", "50000", "'many'"):
        ensemble.run(PLANTS)


def test_undisturbed_runs_read_one_array_of_zeros(made):
    """Of seven links 43 kB a sample: with a copy for each run it was most of a design's memory."""
    first, second = (looped(made, estimator=False).prepared(**{**RUN, "noise": None}) for _ in range(2))
    zeros = first.arrays["disturbance"]
    assert not zeros.any()
    assert not zeros.flags.writeable
    assert np.shares_memory(zeros, second.arrays["disturbance"])


def test_metrics_of_one_run_are_those_of_its_trajectory(made):
    loop = looped(made)
    found = loop.ensemble(**RUN).run(PLANTS[:4], range(4))
    assert found.metrics_of(TORN) == alone(loop, TORN, **RUN).metrics()
    expected, metrics = alone(loop, 0, **RUN).metrics(), found.metrics_of(0)
    assert set(metrics) == set(expected)
    assert metrics["settling_time_s"] is None
    for name, value in expected.items():
        assert metrics[name] == (value if value is None else pytest.approx(value, rel=1e-13)), name
