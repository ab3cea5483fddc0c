"""Many plants in lanes: each run is that of `Loop.run`, bit by bit, whatever the lanes, the threads and the others."""

from dataclasses import replace

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller, Loop, Reduction, Sine, Step
from flexhinf.robot import paper_arm
from flexhinf.scalars import maximum

#: Runs; the third is of an arm that is so soft that it is torn apart.
COUNT, TORN, DURATION = 11, 2, 0.3


#: Ways to make the runs: few of them alone, or as many as are worth it in lanes.
MANY, FEW = "0", str(10**9)


@pytest.fixture(autouse=True)
def worth(monkeypatch, request):
    """Also these few runs go in lanes, unless a test says otherwise."""
    monkeypatch.setenv("FLEXHINF_LANES_FROM", MANY)
    return lambda value: monkeypatch.setenv("FLEXHINF_LANES_FROM", value)


def stiffness(k):
    return -1e7 if k == TORN else 100.0 - 3.0 * k


def rows(count=COUNT):
    return [{"stiffness": stiffness(k)} for k in range(count)]


def prepared(made, estimator=True, sub_steps: int | None = 2, **options):
    """A loop, the options of its runs, and the ensemble of them."""
    pieces = options.pop("pieces", False)
    controller = Controller(made.law, made.ukf() if estimator else None, 1e-3)
    loop = Loop(paper_arm().plant(), controller.in_pieces() if pieces else controller, sub_steps, **options)
    arguments = {
        "reference": Step(0.3, at=0.02), "disturbance": {"link_torque": Step(0.2, at=0.1)}, "noise": 1e-3,
        "duration": DURATION,
    }  # fmt: skip
    return loop, arguments if estimator else {**arguments, "noise": None, "disturbance": None}


def alone(loop, arguments, k, seed=0, **other):
    plant = loop.true_plant.with_parameters(stiffness=stiffness(k))
    one = Loop(plant, loop.controller, loop._sub_steps_option)
    one.channel = loop.channel
    return one.run(**arguments, seed=seed, **other)


def same(one, other):
    for name, values in one.metrics().items():
        np.testing.assert_array_equal(values, other.metrics()[name])
    for name in ("codes", "diverged_at", "sub_steps", "kept"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    "options",
    [{}, {"delay": 2e-3, "quantisation": 1e-4}, {"estimator": False}, {"pieces": True}],
    ids=["plain", "delayed", "state", "pieces"],
)
def test_runs_are_those_of_a_loop(made, options):
    loop, arguments = prepared(made, **options)
    kept = tuple(loop.true_plant.states)
    samples = np.arange(round(DURATION / 1e-3) + 1)
    found = loop.ensemble(**arguments, kept=kept, instants=samples).run(rows(), np.arange(COUNT))
    for k in range(COUNT):
        run = alone(loop, arguments, k, seed=k)
        end = len(run.time)
        np.testing.assert_array_equal(found.kept[k, :end], run.signals["state"])
        assert np.isnan(found.kept[k, end:]).all()
        assert found.completed[k] == (run.status == "completed") == (k != TORN)
        metrics = {name: values[k] for name, values in found.metrics().items()}
        if run.diverged_at is not None:
            assert found.diverged_at[k] == run.diverged_at
            assert all(np.isnan(values).all() for values in metrics.values())
            continue
        for name, expected in run.metrics().items():
            if name in ("settling_time_s", "rise_time_s"):
                expected = np.inf if expected is None else expected
            exact = 1e-13 if name.endswith("rmse") else 0.0
            np.testing.assert_allclose(metrics[name], expected, rtol=exact, atol=0.0, err_msg=name)


@pytest.mark.ci("compiles an ensemble of every width, as it ships")
def test_neither_lanes_nor_threads_nor_other_runs_matter(made):
    loop, arguments = prepared(made)
    ensemble = loop.ensemble(**arguments, kept=["link_position"], instants=[0, 100, 300])
    seeds, states = np.arange(COUNT) + 2**40, 0.01 * np.arange(4.0 * COUNT).reshape(COUNT, 4)
    loads = np.column_stack([np.linspace(0.5, 2.0, COUNT), np.zeros(COUNT)])
    whole = ensemble.run(rows(), seeds, states, loads)
    for lanes, threads in ((1, 1), (2, 2), (8, 1), (8, 3)):
        same(ensemble.run(rows(), seeds, states, loads, lanes=lanes, threads=threads), whole)
    for traced, lanes in ((0, None), (3, None), (9, 8), (99, 8)):
        some = ensemble.run(rows(), seeds, states, loads, lanes=lanes, traced=traced)
        same(replace(some, kept=whole.kept), whole)
        np.testing.assert_array_equal(some.kept, whole.kept[:traced])
    for k in (0, 1, TORN, COUNT - 1):
        only = ensemble.run(rows()[k : k + 1], seeds[k : k + 1], states[k : k + 1], loads[k : k + 1])
        same(only, ensemble.run(rows()[k : k + 1], [seeds[k]], states[k : k + 1], loads[k : k + 1], lanes=1))
        assert only.metrics()["peak_input"][0] == pytest.approx(
            whole.metrics()["peak_input"][k], abs=0, nan_ok=True
        )
        np.testing.assert_array_equal(only.kept[0], whole.kept[k])
    run = alone(
        loop,
        {**arguments, "disturbance": {"link_torque": Step(0.1, at=0.1)}},
        0,
        seed=2**40,
        initial_state=states[0],
    )
    assert whole.kept[0, -1, 0] == run.signals["state"][-1, 0]


@pytest.mark.ci("compiles an ensemble of its own")
@pytest.mark.parametrize("delay", [0.0, 2e-3])
def test_each_run_begins_from_its_own_input(made, delay):
    loop, arguments = prepared(made, delay=delay)
    inputs = np.linspace(-1.0, 1.0, COUNT)[:, None]
    ensemble = loop.ensemble(**arguments, kept=["link_position"], instants=[1, 50])
    found = ensemble.run(rows(), np.arange(COUNT), initial_inputs=inputs)
    for k in (0, COUNT - 1):
        run = alone(loop, arguments, k, seed=k, initial_input=inputs[k])
        np.testing.assert_array_equal(found.kept[k, :, 0], run.signals["state"][[1, 50], 0])
    with pytest.raises(InvalidInput, match=rf"initial[\s\S]*\({COUNT}, 1\)"):
        ensemble.run(rows(), np.arange(COUNT), initial_inputs=inputs[:2])


@pytest.mark.ci("compiles an ensemble and its loops")
def test_each_plant_has_its_own_sub_steps_and_its_own_loop_agrees(made):
    loop, arguments = prepared(made, sub_steps=None)
    ensemble = loop.ensemble(**arguments, kept=["motor_position"], instants=[300])
    found = ensemble.run([{"stiffness": 100.0}, {"stiffness": 3000.0}, {"stiffness": 99.0}], [0, 0, 0])
    assert len(set(found.sub_steps.tolist())) == 2
    for k, value in enumerate((100.0, 3000.0, 99.0)):
        run = Loop(paper_arm().plant().with_parameters(stiffness=value), loop.controller).run(**arguments)
        assert found.kept[k, 0, 0] == run.signal("state", "motor_position")[300]
        assert found.sub_steps[k] == run.settings["sub_steps"]


def test_commands_that_are_no_step_and_steps_at_once(made):
    for reference in (Sine(0.2, 2.0), 0.2, -0.2):
        loop, arguments = prepared(made)
        arguments = {**arguments, "reference": reference}
        metrics = loop.ensemble(**arguments).run(rows(1), [3]).metrics()
        for name, expected in alone(loop, arguments, 0, seed=3).metrics().items():
            if expected is None and name != "overshoot_percent" and not isinstance(reference, Sine):
                expected = np.inf
            expected = np.nan if expected is None else expected
            np.testing.assert_allclose(metrics[name][0], expected, rtol=1e-13, atol=0.0, err_msg=name)


def test_a_reduction_of_ones_own(made):
    loop, arguments = prepared(made)
    fastest = Reduction(
        (0.0,),
        lambda kept, now: np.array([maximum(kept[0], abs(now.state[1]))]),
        lambda kept, command: {"fastest": kept[0]},
    )
    found = loop.ensemble(**arguments, reductions=[fastest]).run(rows(3), [0, 1, 2]).metrics()
    assert found["fastest"][1] == np.abs(alone(loop, arguments, 1, seed=1).signals["state"][:, 1]).max()
    assert np.isnan(found["fastest"][TORN])


@pytest.mark.parametrize("returned", [lambda kept: kept[0], lambda kept: np.array([kept[0], 0.0])])
def test_a_reduction_of_another_length_is_refused(made, returned):
    loop, arguments = prepared(made)

    def longer(kept, now):
        return returned(kept)

    ensemble = loop.ensemble(**arguments, reductions=[Reduction((0.0,), longer, lambda kept, command: {})])
    with pytest.raises(InvalidInput, match=r"longer[\s\S]*expected 1 [\s\S]*\((2,)?\)"):
        ensemble.run(rows(3), [0, 1, 2])
    with pytest.raises(InvalidInput, match=r"start=\(0.0,\)"):
        Reduction(0.0, longer, lambda kept, command: {})  # type: ignore[arg-type]


def test_what_does_not_fit_is_refused(made):
    loop, arguments = prepared(made)
    ensemble = loop.ensemble(**arguments)
    nominal = paper_arm().plant().parameters.vector()[None]
    for attempt, message in (
        (lambda: ensemble.run(nominal[:, 1:]), "parameters"),
        (lambda: ensemble.run(nominal, [1, 2]), "seeds"),
        (lambda: ensemble.run(nominal, -1), "seed"),
        (lambda: ensemble.run(nominal, initial_states=np.zeros((1, 3))), r"initial.*states[\s\S]*\(1, 4\)"),
        (lambda: ensemble.run(nominal, loads=[[np.nan, 1.0]]), "loads"),
        (lambda: ensemble.run([{"mass_of_nothing": 1.0}]), "mass_of_nothing"),
        (lambda: loop.ensemble(0.1, duration=0.01).run(nominal, loads=[[1.0, 1.0]]), "loads=None"),
        (lambda: loop.ensemble(0.1, kept=["colour"]), "colour"),
        (lambda: loop.ensemble(0.1, duration=0.1, kept=["link_position"], instants=[101]), "instant"),
        (
            lambda: Loop(loop.true_plant, loop.controller).ensemble(0.1).run([{"stiffness": 1e18}]),
            r" 1\.414e\+09 rad",
        ),
    ):
        with pytest.raises(InvalidInput, match=message):
            attempt()
    assert len(ensemble.run(np.zeros((0, nominal.shape[1]))).codes) == 0
