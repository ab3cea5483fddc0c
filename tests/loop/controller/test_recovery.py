"""Nothing that happens at one sample makes a controller unusable: refused and missing measurements, copies, threads."""

import _ctypes
import copy
import pickle
import threading
from pathlib import Path

import numpy as np
import pytest
from tests.costs import resident
from tests.refusals import refused_with

from flexhinf.errors import ControllerInUse, InvalidInput, NumericalFailure
from flexhinf.estimation import ExtendedKalmanFilter, OutputInjectionObserver, UnscentedKalmanFilter
from flexhinf.hinf import solve_hji
from flexhinf.loop import Controller, Loop, Step
from flexhinf.loop.controller import controller as controller_file
from flexhinf.loop.controller.memory import BAD_RESULT, SPACING, StateHistory
from flexhinf.plant import Law, Plant
from flexhinf.robot import paper_arm

# Kernels that run once each: 2 s instead of 3 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

SETTINGS = {"process_noise": 1e-8, "measurement_noise": 1e-6, "mean": np.zeros(4), "covariance": 1e-4}


@pytest.fixture(scope="module")
def cubic():
    """A law of degree 3 without limits: it answers 1e6 rad with 1e18 V."""
    return solve_hji(paper_arm().problem(), gamma=300.0, degree=4)


def arm_filter(kind):
    return kind(paper_arm().plant(), 1e-3, **SETTINGS)


class Numbered(Law):
    """A law without a key of its own."""

    state_names, input_names = ("q", "q_integral"), ("push",)
    operating_point, operating_input, law_data = np.zeros(2), np.zeros(1), np.ones(1)

    def evaluate_law(self, x, data):
        return -data * x[0]


# A measurement that is missing ----------------------------------------------------------------------
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("composed", [False, True])
@pytest.mark.parametrize("kind", [UnscentedKalmanFilter, ExtendedKalmanFilter, OutputInjectionObserver])
def test_without_a_measurement_the_estimate_is_predicted(made, monkeypatch, kind, composed):
    """Against the updates by hand: prediction only, integrals of the predicted position, covariance grown by R^v."""
    if composed:
        monkeypatch.setattr(controller_file, "ONE_TRACE", -1)
    estimator = arm_filter(kind)
    estimator.initial = estimator.initial_at([0.3, 0.1, 0.25, -0.1])
    controller = Controller(made.law, estimator, latency=0)
    belief, parameters = estimator.initial, estimator.plant.parameters
    integral, before = 0.0, None
    named = parameters.named(parameters.vector())
    for k in range(4):
        if k == 0:  # without a first measurement there is nothing to predict from
            belief = estimator.measurement_update(
                belief, np.array([0.31]), np.zeros(1), named, estimator.measurement_noise
            )
        position = 0.31 if k == 0 else belief.mean[0]
        integral += 0.0 if before is None else 1e-3 * (0.5 * (before + position) - 0.3)
        u = made.law.gain @ [*belief.mean, integral]
        y, r = (0.31, 0.3) if k == 0 else (None, None)
        np.testing.assert_allclose(controller.step(y, r), u, rtol=1e-9)
        np.testing.assert_allclose(controller.estimate, belief.mean, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(controller.integrals, [integral], rtol=1e-9, atol=1e-15)
        belief = estimator.time_update(belief, u, named, estimator.process_noise)
        after = controller.memory.named(controller._history.memory).belief[1]
        np.testing.assert_allclose(after, belief[1], rtol=1e-8, atol=1e-16)  # P, or W
        before = position


def test_a_missed_sample_costs_little_and_a_corrected_one_takes_over(made):
    """Ten samples in a hundred are lost: the estimate stays that of all measurements to 2 mrad."""
    whole, gaps = (Controller(made.law, made.ukf()) for _ in range(2))
    rng = np.random.default_rng(0)
    for k in range(300):
        y = 0.2 * np.sin(0.01 * k) + 1e-3 * rng.normal()
        whole.step(y, 0.2)
        gaps.step(None if 100 <= k < 110 else y, 0.2)
    np.testing.assert_allclose(gaps.estimate[::2], whole.estimate[::2], atol=2e-3)


def test_without_an_estimator_there_is_nothing_to_predict_with(made):
    controller = Controller(made.law, None)
    first = controller.step(np.zeros(4), 1.0)
    with refused_with(InvalidInput, "predict", "None"):
        controller.step(None, 1.0)
    again = Controller(made.law, None)
    np.testing.assert_array_equal(again.step(np.zeros(4), 1.0), first)
    np.testing.assert_array_equal(again.step(np.ones(4)), controller.step(np.ones(4)))


# A measurement that is refused ----------------------------------------------------------------------
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("kind", [UnscentedKalmanFilter, ExtendedKalmanFilter])
def test_a_step_that_fails_changes_nothing(cubic, kind):
    """1e200 rad leaves the finite numbers at once: memory, estimate and command stay, and prediction goes on."""
    spoiled, clean = (Controller(cubic, arm_filter(kind)) for _ in range(2))
    for k in range(10):
        if k == 5:
            with refused_with(NumericalFailure, "estimate", "finite", "y=1e+200, reference=9.0") as caught:
                spoiled.step(1e200, 9.0)
            assert "step(None)" in caught.value.advice
            np.testing.assert_array_equal(spoiled.estimate, clean.estimate)
        y = None if k == 5 else 1e-3 * k
        np.testing.assert_array_equal(
            spoiled.step(y, 0.1 if k < 5 else None), clean.step(y, 0.1 if k < 5 else None)
        )


@pytest.mark.parametrize("good", [10, 200])
@pytest.mark.parametrize("wild", [1e3, 1e6, 1e30])
@pytest.mark.parametrize("kind", [UnscentedKalmanFilter, ExtendedKalmanFilter])
def test_after_a_wild_measurement_the_controller_works_again(cubic, kind, wild, good):
    """Finite at first, NaN some samples later: then an earlier memory stands, and the steps are good ones."""
    controller = Controller(cubic, arm_filter(kind))
    for _ in range(good):
        controller.step(0.0, 0.1)
    earlier = controller.integrals
    controller.step(wild, 0.1)
    failed = 0
    for _ in range(20):
        try:
            u = controller.step(0.0)
        except NumericalFailure:
            failed += 1
    assert failed == 2
    assert abs(u[0]) < 5.0
    assert np.all(np.abs(controller.estimate) < 0.1)
    assert -(good + 20) * 1e-4 <= controller.integrals[0] < 0.0
    if good > 2 * SPACING:  # not the memory of the start
        assert controller.integrals[0] < earlier[0] + 2 * SPACING * 1e-4


@pytest.mark.parametrize("good", [10, 200])
def test_a_wild_command_that_is_held_is_forgotten_with_its_memory(cubic, good):
    """Its step is finite, and the integral of the error is not much later: an earlier memory brings its own command."""
    controller = Controller(cubic, arm_filter(UnscentedKalmanFilter))
    for _ in range(good):
        controller.step(0.0, 0.1)
    controller.step(0.0, 1e300)
    failed = 0
    for _ in range(20):
        try:
            u = controller.step(0.0)
        except NumericalFailure:
            failed += 1
    assert failed == (2 if good > 2 * SPACING else 4)
    assert abs(u[0]) < 5.0
    assert (controller.integrals[0] < 0.0) == (
        good > 2 * SPACING
    )  # the start has the command of the operating point


def test_a_sensor_that_stays_wild_is_refused_and_then_forgotten(cubic):
    controller = Controller(cubic, arm_filter(UnscentedKalmanFilter))
    fresh = controller.fresh()
    for _ in range(100):
        controller.step(0.0, 0.1)
    for _ in range(50):
        with pytest.raises(NumericalFailure):
            controller.step(1e200)
    fresh.step(0.0, 0.1)
    assert np.isfinite(controller.step(0.0)).all()
    assert abs(controller.step(0.0)[0] - fresh.step(0.0)[0]) < 0.5


# Copies, pickles and threads ------------------------------------------------------------------------
def lambdas(kind=UnscentedKalmanFilter):
    plant = Plant(
        lambda x, u, d, p: np.array([x[1], p.gain * u[0] - np.sin(x[0])]),
        lambda x, u, p: x[:1], ("q", "v"), ("push",), parameters={"gain": 2.0},
    )  # fmt: skip
    return kind(plant, 1e-2, 1e-8, 1e-6, np.zeros(2), 1e-4)


def controllers(made, kind):
    if kind == "lambdas":
        law = made.LinearLaw(("q", "v", "q_integral"), ("push",), [[-3.0, -2.0, -1.0]])
        return Controller(law, lambdas(), 1e-2, saturation=3.0)
    if kind == "ekf":
        return Controller(
            made.law, arm_filter(ExtendedKalmanFilter), saturation=(-5.0, 7.0), start="bumpless"
        )
    return Controller(made.law, None if kind == "state" else arm_filter(UnscentedKalmanFilter))


COPIES = {"copy": copy.copy, "deepcopy": copy.deepcopy, "pickle": lambda it: pickle.loads(pickle.dumps(it))}


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize("how", COPIES)
@pytest.mark.parametrize("kind", ["ukf", "ekf", "state", "lambdas"])
def test_a_copy_goes_on_with_a_memory_of_its_own(made, kind, how):
    one = controllers(made, kind)
    count = len(one.measured)
    for k in range(SPACING + 3):
        one.step(np.full(count, 0.01 * k), 0.5)
    other = COPIES[how](one)
    assert not np.shares_memory(one._history.memory, other._history.memory)
    np.testing.assert_array_equal(other.estimate, one.estimate)
    kept = one._history.memory.copy()
    y = [np.full(count, 0.02 * k) for k in range(5)]
    ahead = [other.step(value) for value in y]
    np.testing.assert_array_equal(one._history.memory, kept)
    np.testing.assert_allclose([one.step(value) for value in y], ahead, rtol=1e-9)
    np.testing.assert_allclose(COPIES[how](other).estimate, other.estimate)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("how", COPIES)
@pytest.mark.parametrize("kind", ["ukf", "lambdas"])
def test_a_loop_copies_and_pickles_after_a_run(made, kind, how):
    controller = controllers(made, kind)
    loop = Loop(controller.estimator.plant, controller, quantisation=1e-3, delay=2 * controller.period)
    run = loop.run(Step(0.2), duration=0.1)
    again = COPIES[how](loop).run(Step(0.2), duration=0.1)
    for name, values in run.signals.items():
        np.testing.assert_allclose(again.signals[name], values, rtol=1e-9, atol=1e-12)


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("how", COPIES)
@pytest.mark.parametrize("kind", [UnscentedKalmanFilter, ExtendedKalmanFilter, OutputInjectionObserver])
def test_an_estimator_copies_and_pickles_after_it_was_used(kind, how):
    one = lambdas(kind)
    one.predict([0.1])
    one.correct([0.02])
    other = COPIES[how](one)
    kept = one.mean, one.covariance
    other.predict([0.3])
    other.correct([0.01])
    np.testing.assert_array_equal(one.mean, kept[0])
    np.testing.assert_array_equal(one.covariance, kept[1])
    one.predict([0.3])
    one.correct([0.01])
    np.testing.assert_allclose(other.mean, one.mean, rtol=1e-12)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-12)


def writable(part, seen, path=""):
    """Paths of the arrays inside an object of ours that can be written, with the arrays."""
    if isinstance(part, np.ndarray):
        return [(path, part)] if part.flags.writeable else []
    if id(part) in seen:
        return []
    seen.add(id(part))
    inside = part if isinstance(part, dict) else dict(enumerate(part)) if isinstance(part, tuple) else {}
    if type(part).__module__.startswith("flexhinf") and hasattr(part, "__dict__"):
        inside = {**inside, **vars(part)}
    return [found for name, entry in inside.items() for found in writable(entry, seen, f"{path}.{name}")]


@pytest.mark.parametrize("how", COPIES)
def test_copies_share_nothing_that_can_be_written(cubic, how):
    """Laws, filters and problems share their arrays with copies of them, copies of pickles too: none can be written."""
    cubic.law([0.1] * 5)
    one = COPIES[how]((cubic, arm_filter(UnscentedKalmanFilter), arm_filter(ExtendedKalmanFilter)))
    for part in (*one, arm_filter(OutputInjectionObserver)):
        other = copy.copy(part)
        theirs = writable(other, set())
        shared = [p for p, x in writable(part, set()) for _, y in theirs if x.size and np.shares_memory(x, y)]
        assert not [path for path in shared if "._" not in path]
    with pytest.raises(ValueError, match="read-only"):
        one[0].P[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        one[1].process_noise[0, 0] = 1.0


def test_a_pickled_plant_of_any_code_is_the_same_plant():
    plant = lambdas().plant
    other = pickle.loads(pickle.dumps(plant))
    x, u = [0.3, -0.2], [0.7]
    np.testing.assert_allclose(other.derivative(x, u), plant.derivative(x, u), rtol=1e-15)
    np.testing.assert_allclose(other.with_parameters(gain=3.0).derivative(x, u), [-0.2, 2.1 - np.sin(0.3)])
    assert other.code_key == pickle.loads(pickle.dumps(other)).code_key


def test_two_laws_of_one_number_are_not_taken_for_one(made):
    """Laws without a key of their own are numbered in each process: a pickle must not bring its number along."""
    law = Numbered()
    assert law.law_key
    sent = pickle.dumps(law)
    others = [Numbered() for _ in range(3)]
    assert pickle.loads(sent).law_key not in {other.law_key for other in (law, *others)}


def test_two_threads_at_once_are_told(made):
    """A step that waits inside its compiled part, and another one meanwhile; the first ends as it should."""
    controller, clean = controllers(made, "ukf"), controllers(made, "ukf")
    controller.step(0.0, 0.1)
    clean.step(0.0, 0.1)
    run, *rest = controller._ready
    inside, go, results = threading.Event(), threading.Event(), []

    def slow():
        inside.set()
        go.wait(300.0)
        return run()

    controller._ready = (slow, *rest)
    thread = threading.Thread(target=lambda: results.append(controller.step(0.01)))
    thread.start()
    assert inside.wait(300.0)
    for act in (lambda: controller.step(0.02), controller.reset, lambda: controller.step(None)):
        with pytest.raises(ControllerInUse, match="thread"):
            act()
    go.set()
    thread.join()
    np.testing.assert_array_equal(results[0], clean.step(0.01))
    controller._ready = (run, *rest)
    np.testing.assert_array_equal(controller.step(0.03), clean.step(0.03))


def test_a_small_step_is_shorter_than_an_exchange_of_the_interpreters_lock(made):
    """It would cost a tenth of the call, and up to 5 ms where another thread computes."""
    controller = controllers(made, "ukf")
    controller.step(0.0, 0.1)
    assert not controller.composed
    assert controller._ready[0].func._flags_ & _ctypes.FUNCFLAG_PYTHONAPI


def test_a_step_that_is_interrupted_does_not_lock_the_controller(made):
    controller = controllers(made, "ukf")
    controller.step(0.0, 0.1)
    run, *rest = controller._ready

    def interrupted():
        raise KeyboardInterrupt

    controller._ready = (interrupted, *rest)
    with pytest.raises(KeyboardInterrupt):
        controller.step(0.1)
    controller._ready = (run, *rest)
    assert np.isfinite(controller.step(0.1)).all()


@pytest.mark.ci("a million steps")
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_a_million_steps_take_no_memory(made):
    """Measured, missing and refused samples; what the first tenth needs is all that is ever needed."""
    controller = Controller(made.law, made.ukf(), saturation=20.0)
    step, y = controller.step, np.array([0.1])

    def tenth():
        for _ in range(100):
            for _ in range(980):
                step(y, 0.2)
            for _ in range(10):
                step(None)
            for bad in [-1.7e308, 1.7e308] * 5:
                with pytest.raises(NumericalFailure):
                    step(bad)
                step(y)

    tenth()
    before = resident()
    for _ in range(9):
        tenth()
    assert resident() - before < 1_000.0


def test_a_brake_under_way_outlasts_going_back():
    """As in exported C: of the memory that is left, how far the brake is and the path rate stay."""
    memory = np.array([0.0, 0.0, 0.0, 1.0])  # a command, whether it is held, the brake, the path rate
    history = StateHistory(memory, slice(0, 1), 1, braking=slice(2, 4))
    history.memory[0] = 3.0
    for _ in range(2 * SPACING):
        history.good(True)
    history.memory[:] = [7.0, 1.0, 0.4, 0.6]
    assert not history.fail(BAD_RESULT)
    assert history.fail(BAD_RESULT)
    np.testing.assert_array_equal(history.memory, [3.0, 0.0, 0.4, 0.6])
    history.memory[:] = [7.0, 1.0, np.nan, 2.0]  # what is no fraction goes back too
    history.good(True)
    history.fail(BAD_RESULT)
    assert history.fail(BAD_RESULT)
    np.testing.assert_array_equal(history.memory[2:], [0.0, 1.0])
