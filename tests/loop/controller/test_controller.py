import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.loop import Controller
from flexhinf.loop.controller.step import controller_step
from flexhinf.robot import paper_arm

# Kernels that run once each: 1 s instead of 2 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture
def controller(made):
    return Controller(made.law, made.ukf(), saturation=20.0)


@pytest.mark.oracle
@pytest.mark.parametrize("estimated", [True, False])
def test_the_compiled_step_equals_the_same_text_on_floats(made, estimated):
    controller = Controller(made.law, made.ukf() if estimated else None, saturation=6.0, latency=0)
    rng = np.random.default_rng(0)
    memory, data = controller.initial_memory(), controller.data_vector
    for k in range(60):
        y = 0.1 * rng.normal(size=len(controller.measured))
        named = controller.memory.named(memory), controller.data.named(data)
        r = np.array([0.01 * k])
        u, estimate, after = controller_step(
            controller.law_code, controller.estimator, controller._sources, y, r, *named
        )
        memory = controller.memory.flat(after)
        np.testing.assert_allclose(controller.step(y, r), u, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(controller.estimate, estimate, rtol=1e-11, atol=1e-14)


def test_state_feedback_by_hand(made):
    """Trapezoidal integral of the error, from the second sample on; the command is held."""
    controller, gain, h = Controller(made.law, None, 0.1), made.law.gain[0], 0.1
    x = np.array([[0.1, 0.0, 0.2, 0.0], [0.3, 0.5, 0.1, -0.2], [0.2, 0.1, 0.0, 0.3]])
    e1 = h * ((0.1 + 0.3) / 2 - 1.0)
    e2 = e1 + h * ((0.3 + 0.2) / 2 - 2.0)
    for state, r, integral in zip(x, (1.0, 2.0, 3.0), (0.0, e1, e2)):
        np.testing.assert_allclose(controller.step(state, r), [gain @ [*state, integral]], rtol=1e-13)


def test_values_come_in_any_form(controller):
    results = []
    for y, r in (
        (0.25, 1.0),
        ([0.25], [1.0]),
        (np.array([0.25]), np.array([1])),
        (np.float64(0.25), 1),
        (np.array(0.25), True),
    ):
        controller.reset()
        controller.step(y, r)
        results.append(float(controller.step(y, r)[0]))
    assert len(set(results)) == 1
    assert results[0] != 0.0


def test_the_input_is_a_copy(controller):
    first = controller.step(0.1, 1.0)
    kept = first.copy()
    first[:] = 99.0
    second = controller.step(0.2, 1.0)
    assert second[0] != 99.0
    assert first[0] == 99.0
    assert kept[0] != second[0]


def test_without_a_command_the_last_one_is_kept(made):
    said, kept = Controller(made.law, None), Controller(made.law, None)
    for k in range(5):
        x = np.full(4, 0.01 * k)
        np.testing.assert_array_equal(said.step(x, 0.7), kept.step(x, 0.7 if k == 0 else None))


def test_before_any_command_it_holds_the_operating_point(made):
    law = made.law_about([1.0])
    controller = Controller(law, None)
    for _ in range(10):
        np.testing.assert_allclose(controller.step(law.operating_point[:4]), law.operating_input, rtol=1e-9)


def test_reset_forgets_everything(controller):
    def record():
        return [float(controller.step(0.01 * k)[0]) for k in range(10)]

    assert np.all(np.isnan(controller.estimate))
    first = record()
    controller.step(0.3, 2.0)
    controller.reset()
    assert np.all(np.isnan(controller.estimate))
    assert record() == first


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("redraw", [True, False])
def test_reset_at_a_state_is_an_estimator_that_starts_there(made, redraw):
    there = [0.5, 0.1, 0.6, -0.2]
    moved = Controller(made.law, made.ukf(redraw=redraw))
    moved.reset(there)
    started = Controller(made.law, made.ukf(redraw=redraw, mean=there))
    for k in range(5):
        np.testing.assert_array_equal(moved.step(0.5 + 0.01 * k, 1.0), started.step(0.5 + 0.01 * k, 1.0))
    np.testing.assert_array_equal(moved.estimate, started.estimate)


def test_two_controllers_do_not_share_their_memory(made):
    one, two = Controller(made.law, made.ukf()), Controller(made.law, made.ukf())
    first = one.step(0.1, 1.0)
    one.step(0.2, 1.0)
    np.testing.assert_array_equal(two.step(0.1, 1.0), first)
    np.testing.assert_array_equal(one.fresh().step(0.1, 1.0), first)


@pytest.mark.parametrize(("y", "r"), [(0.1, np.nan), (0.1, -np.inf), (np.inf, np.nan)])
def test_a_bad_sample_changes_nothing(made, y, r):
    spoiled, clean = Controller(made.law, made.ukf()), Controller(made.law, made.ukf())
    for k in range(6):
        if k == 3:
            with pytest.raises(NumericalFailure, match=f"finite(.|\n)* y={y}, reference={r}"):
                spoiled.step(y, r)
        reference = 1.5 if k < 3 else None  # the command of the last good sample is the one that is kept
        np.testing.assert_array_equal(spoiled.step(0.01 * k, reference), clean.step(0.01 * k, reference))


def test_a_damaged_memory_is_told_and_reset_helps(controller):
    first = controller.step(0.1, 1.0)
    controller._history.memory[:] = np.nan
    with refused_with(NumericalFailure, "estimate", "finite", "y=0.1, reference=1.0") as caught:
        controller.step(0.1, 1.0)
    assert "reset()" in caught.value.advice
    assert "y=0.1" in caught.value.found
    with pytest.raises(NumericalFailure, match=" 32 to 64 "):
        controller.step(0.1, 1.0)
    controller.reset()
    np.testing.assert_array_equal(controller.step(0.1, 1.0), first)


@pytest.mark.parametrize(
    ("y", "r"),
    [
        ([0.1, 0.2], 1.0),
        ([], 1.0),
        ("far", 1.0),
        (0.1, [1.0, 2.0]),
        (0.1, "up"),
        (0.1, []),
        (1j, 1.0),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(made, y, r):
    controller, clean = Controller(made.law, made.ukf()), Controller(made.law, made.ukf())
    with pytest.raises(InvalidInput, match="link_position"):
        controller.step(y, r)
    np.testing.assert_array_equal(controller.step(0.1, 1.0), clean.step(0.1, 1.0))


def test_several_signals(made):
    plant, law = made.two_inputs()
    controller = Controller(
        law, UnscentedKalmanFilter(plant, 1e-2, 1e-6, 1e-4, np.zeros(4), 1e-2), 1e-2, [1.0, 0.5]
    )
    assert controller.step([0.0, 9.0], 1.0).tolist() == [1.0, -0.5]
    for y in (0.1, [0.1], [0.1, 0.2, 0.3], [[0.1, 0.2]]):
        with pytest.raises(InvalidInput):
            controller.step(y, 1.0)


def test_without_integrals_a_command_is_refused(made):
    plant, _ = made.two_inputs()
    law = made.LinearLaw(plant.states, plant.inputs, -np.ones((2, 4)))
    controller = Controller(law, None, 1e-2)
    assert controller.step([1.0, 0.0, 0.0, 0.0]).tolist() == [-1.0, -1.0]
    with pytest.raises(InvalidInput):
        controller.step([1.0, 0.0, 0.0, 0.0], 1.0)


def test_a_state_to_reset_to_needs_an_estimator(made):
    with refused_with(InvalidInput, "estimate", "array([0., 0., 0., 0.])"):
        Controller(made.law, None).reset(np.zeros(4))
    for state in (np.zeros(5), [0, 0, 0, np.nan], "rest"):
        with pytest.raises(InvalidInput):
            Controller(made.law, made.ukf()).reset(state)


def test_codes_are_shared_only_where_they_are_the_same(made):
    states, inputs, gain = made.law.state_names, made.law.input_names, made.law.gain

    class Other(made.LinearLaw):
        def evaluate_law(self, x, data):
            return 2.0 * super().evaluate_law(x, data)

    one = Controller(made.law, None, saturation=100.0)
    again = Controller(made.LinearLaw(states, inputs, 3.0 * gain), None, saturation=1.0)
    other = Controller(Other(states, inputs, gain), None, saturation=100.0)
    assert one.traced() is again.traced()
    assert one.traced() is not other.traced()
    x = np.array([0.1, 0.0, 0.1, 0.0])
    np.testing.assert_allclose(other.step(x, 0.0), 2.0 * one.step(x, 0.0), rtol=1e-14)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda m: Controller("law", None), r"flexhinf\.plant\.Law.* 'law'"),
        (lambda m: Controller(m.law, "ukf"), r"flexhinf\.plant\.Estimator.* 'ukf'"),
        (lambda m: Controller(m.law, None, 0.0), r"period.*positive[\s\S]* 0\.0"),
        (lambda m: Controller(m.law, None, np.nan), r"period.*positive[\s\S]* nan"),
        (lambda m: Controller(m.law, m.ukf(2e-3)), r" 0\.001 s, got 0\.002 s"),
        (
            lambda m: Controller(m.law, None, 1e-3, (3.0, 1.0)),
            r"saturation[\s\S]*lower=\[3\.0\], upper=\[1\.0\]",
        ),
        (
            lambda m: Controller(m.LinearLaw(("a_integral", "a"), ("u",), [1, 1]), None),
            r"integrals[\s\S]*\['a_integral', 'a'\]",
        ),
        (
            lambda m: Controller(m.LinearLaw(("a", "b_integral"), ("u",), [1, 1]), None),
            r"integrals[\s\S]*\['a', 'b_integral'\]",
        ),
        (
            lambda m: Controller(m.LinearLaw(("a",), ("u",), [1], point=[0, 0]), None),
            r"names[\s\S]* \(1,\) .* \(2,\) ",
        ),
        (lambda m: Controller(m.LinearLaw(("a",), ("u",), [np.nan]), None), r"law.*finite[\s\S]*got \(1,\)"),
        (
            lambda m: Controller(m.LinearLaw(m.two_inputs()[0].states, ("ua",), np.ones(4)), m.ukf()),
            r"estimator.*law[\s\S]*\['a', 'da', 'b', 'db'\]",
        ),
        (
            lambda m: Controller(m.LinearLaw(paper_arm().plant().states, ("ua",), np.ones(4)), m.ukf()),
            r"estimator.*law[\s\S]*\['ua'\].*\['motor_voltage'\]",
        ),
    ],
)
def test_bad_controllers_are_refused(made, change, word):
    with pytest.raises(InvalidInput, match=word) as caught:
        change(made)
    assert caught.value.advice


@pytest.mark.parametrize("name", ["process_noise", "measurement_noise"])
def test_an_array_of_another_shape_is_refused_by_name(made, name):
    estimator = made.ukf()
    vars(estimator)[name] = np.eye(7)
    with pytest.raises(InvalidInput, match=name):
        Controller(made.law, estimator).step(0.1, 1.0)
